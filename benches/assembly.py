"""Prints time, memory and reached row error of the dense operator, and what a second thread brings."""

import time

import numpy as np

import radiosity as rad

RUNS = 5


def main() -> None:
    print(f"form_factors of the Cornell box, median of {RUNS} runs, one and two threads in turn\n")
    print(f"{'patches':>8s} {'tolerance':>10s} {'row error':>10s} {'segments':>9s} {'MB':>6s}", end="")
    print(f" {'1 thread':>9s} {'2 threads':>10s} {'ratio':>6s}")
    for max_edge, tolerance in ((0.2, 3e-2), (0.1, 1e-1), (0.1, 3e-2), (0.07, 1e-1)):
        scene = rad.scenes.cornell_box(max_edge=max_edge)
        seconds: dict[int, list[float]] = {1: [], 2: []}
        for _ in range(RUNS):
            for threads, times in seconds.items():
                start = time.perf_counter()
                F = rad.form_factors(scene, tolerance=tolerance, threads=threads)
                times.append(time.perf_counter() - start)
        ratio = np.median([one / two for one, two in zip(seconds[1], seconds[2], strict=True)])
        one, two = np.median(seconds[1]), np.median(seconds[2])
        print(f"{scene.n_patches:8d} {tolerance:10.0e} {F.error_estimate:10.1e} {F.segments / 1e6:8.1f}M", end="")
        print(f" {F.nbytes / 1e6:6.1f} {one:8.2f}s {two:9.2f}s {ratio:6.2f}")


if __name__ == "__main__":
    main()
