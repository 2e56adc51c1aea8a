"""Prints the error of `form_factor` on every exact case, and error and cost of `pair_form_factors` by tolerance."""

import json
import time
from pathlib import Path

import numpy as np

import radiosity as rad

DATA = Path(__file__).resolve().parents[1] / "tests" / "data"


def main() -> None:
    cases = json.loads((DATA / "view_factors.json").read_text(encoding="utf-8"))["cases"]
    tolerances = (1e-3, 1e-8)
    print("relative error of form_factor (absolute where the exact value is 0)\n")
    print(f"{'case':40s} {'exact':>14s}" + "".join(f"{f'at {tolerance:g}':>11s}" for tolerance in tolerances))
    for case in cases:
        exact = case["F_ab"]
        errors = [
            abs(rad.form_factor(case["polygon_a"], case["polygon_b"], tolerance) - exact) / (exact or 1.0)
            for tolerance in tolerances
        ]
        print(f"{case['name']:40s} {exact:14.8g}" + "".join(f"{error:11.1e}" for error in errors))
    with np.load(DATA / "form_factor_pairs.npz") as data:
        a, b, exact = data["a"], data["b"], data["f_ab"]
    # Exact values below 1e-30 belong to coplanar triangles with rounded corners: 0 in double precision.
    exact = np.where(exact < 1e-30, 0.0, exact)
    print(f"\n{len(exact)} triangle pairs of all kinds, pair_form_factors on one thread\n")
    print(f"{'tolerance':>10s} {'inside':>9s} {'worst/tol':>10s} {'us a pair':>10s}")
    for tolerance in (1e-2, 1e-3, 1e-4, 1e-6, 1e-8):
        seconds = []
        for _ in range(5):
            start = time.perf_counter()
            value = rad.pair_form_factors(a, b, tolerance, threads=1)
            seconds.append(time.perf_counter() - start)
        error = np.abs(value - exact) / np.where(exact > 0, exact, 1.0)
        cost = 1e6 * np.median(seconds) / len(exact)
        print(f"{tolerance:10.0e} {np.mean(error <= tolerance):9.2%} {error.max() / tolerance:10.3g} {cost:10.2f}")


if __name__ == "__main__":
    main()
