"""Prints the error of `solve` on the stored reference scenes: closed forms and converged path tracing."""

import sys
import time
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests" / "python"))

import radiosity as rad
import references


def main() -> None:
    print("error: area-weighted RMS of B - reference over that of the reference's B - E, all bands; the noise of the")
    print("reference is taken off in quadrature. The estimate is that of the worst band.\n")
    print("| scene | patches | tolerance | estimate | error | noise of the reference | seconds |")
    print("|---|---|---|---|---|---|---|")
    for name in references.NAMES:
        reference = references.load(name)
        for tolerance in (0.1, 0.03, 0.01):
            start = time.perf_counter()
            solution = rad.solve(reference.scene, tolerance=tolerance)
            seconds = time.perf_counter() - start
            error, noise = references.relative_error(
                reference.scene, solution.radiosity, reference.radiosity, reference.standard_error
            )
            print(
                f"| {name} | {reference.scene.n_patches} | {tolerance:.1%} | {solution.error_estimate:.2%} "
                f"| {error:.2%} | {noise:.2%} | {seconds:.2f} |"
            )


if __name__ == "__main__":
    main()
