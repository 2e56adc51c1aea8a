"""Prints steps, time and true error of every solver, against LAPACK's LU of the same system, on three reflectances."""

import time

import numpy as np

import radiosity as rad

METHODS = ("direct", "jacobi", "gauss_seidel", "southwell", "gmres")


def main() -> None:
    scene = rad.scenes.cornell_box(max_edge=0.1)
    F = rad.form_factors(scene, tolerance=0.1)
    matrix = F.toarray()
    print(f"{scene.n_patches} patches, 3 bands, relative residual 1e-6 asked, median of 5 runs\n")
    print(f"{'reflectance':>12s} {'method':14s} {'steps':>6s} {'seconds':>8s} {'error':>9s}")
    for name, rho in (("as painted", scene.reflectance), ("0.95", 0.95), ("0.999", 0.999)):
        weights = np.broadcast_to(rho, scene.reflectance.shape)
        exact = np.stack(
            [np.linalg.solve(np.eye(len(matrix)) - weights[:, [b]] * matrix, scene.emission[:, b]) for b in range(3)], 1
        )
        for method in METHODS:
            seconds = []
            for _ in range(5):
                start = time.perf_counter()
                solution = rad.solve_system(F, scene.emission, rho, method=method)
                seconds.append(time.perf_counter() - start)
            error = np.linalg.norm(solution.radiosity - exact) / np.linalg.norm(exact)
            print(f"{name:>12s} {method:14s} {solution.report.steps:6d} {np.median(seconds):8.3f} {error:9.1e}")


if __name__ == "__main__":
    main()
