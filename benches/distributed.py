"""Form factors on a Dask cluster of this machine: what Dask adds to a product, and local against two workers.

The overhead is the time of F @ x through Dask less that of the same product by the operator of one machine on all
cores, which are the cores that the workers share; medians, turn by turn. Then assembly and solve: one machine against
two workers. Last, the constants of the plan for larger scenes: bytes an entry and a row, rays a second and core, bytes
of a scene on a worker.
"""

import os
import time

import numpy as np
from distributed import Client, LocalCluster

import radiosity as rad

# Patches of the box; row tolerance. Rows of 1,024 rays each, their least number: the product is cheap, so that Dask
# shows.
PATCHES_WIDE, LOOSE = 20_000, 0.99
# Rows that take rays: the time of an assembly.
MAX_EDGE, TIGHT = 0.06, 0.3
PRODUCTS = 41


def cluster(workers, threads):
    return LocalCluster(
        n_workers=workers,
        threads_per_worker=threads,
        host="127.0.0.1",
        dashboard_address="127.0.0.1:0",
        silence_logs=60,
    )


def box_of(patches):
    """The Cornell box of about so many patches."""
    max_edge = 0.1
    scene = rad.scenes.cornell_box(max_edge=max_edge)
    while abs(scene.n_patches / patches - 1.0) > 0.1:
        max_edge *= (scene.n_patches / patches) ** 0.5
        scene = rad.scenes.cornell_box(max_edge=max_edge)
    return scene


def seconds(work):
    start = time.perf_counter()
    return work(), time.perf_counter() - start


def in_turn(F, local, x):
    """(products, 2) seconds of F @ x through Dask and on this machine."""
    return np.array([[seconds(lambda: F @ x)[1], seconds(lambda: local @ x)[1]] for _ in range(PRODUCTS)])


def overhead(scene) -> None:
    local = rad.form_factors(scene, LOOSE, "monte_carlo", progress=False)
    x = np.random.default_rng(0).uniform(size=(scene.n_patches, 3))
    print(f"{scene.n_patches} patches, 3 bands, {local.segments / scene.n_patches:.0f} rays a patch, 4 workers")
    print(f"{'':26s} {'product ms':>10s} {'local ms':>9s} {'overhead ms':>11s}")
    with cluster(4, 1) as workers:
        for name, direct in (("by way of the scheduler", False), ("direct_to_workers=True", True)):
            with Client(workers, direct_to_workers=direct) as client:
                F = rad.distributed.form_factors(scene, client, LOOSE, progress=False)
                spent = in_turn(F, local, x)
                here, there = np.median(spent[:, 1]), np.median(spent[:, 0])
                extra = np.median(spent[:, 0] - spent[:, 1])
                print(f"{name:26s} {1e3 * there:10.1f} {1e3 * here:9.1f} {1e3 * extra:11.1f}")


def two_workers() -> None:
    scene = rad.scenes.cornell_box(max_edge=MAX_EDGE)
    cores = os.cpu_count() or 2
    print(f"\n{scene.n_patches} patches, row tolerance {TIGHT:g}, {cores} cores: seconds, and ratio to one machine")
    print(f"{'':26s} {'assembly':>9s} {'solve':>7s} {'both':>7s} {'ratio':>6s}")

    def solve(F):
        return rad.solve_system(F, scene.emission, scene.reflectance, "gmres", progress=False)

    F, assembly = seconds(lambda: rad.form_factors(scene, TIGHT, "monte_carlo", progress=False))
    expected, solving = seconds(lambda: solve(F))
    both = assembly + solving
    print(f"{'one machine':26s} {assembly:9.2f} {solving:7.2f} {both:7.2f} {1.0:6.2f}")
    n, rays, per_core = scene.n_patches, F.segments, F.segments / assembly / cores
    with cluster(2, max(cores // 2, 1)) as workers, Client(workers) as client:
        G, assembly = seconds(lambda: rad.distributed.form_factors(scene, client, TIGHT, progress=False))
        told, solving = seconds(lambda: solve(G))
        print(
            f"{'two workers':26s} {assembly:9.2f} {solving:7.2f} {assembly + solving:7.2f} "
            f"{(assembly + solving) / both:6.2f}"
        )
        assert np.array_equal(told.radiosity, expected.radiosity)
        entries = (G.nbytes - 12 * n) / 12
    print(f"\nrays       {rays / n:.0f} a patch, {per_core / 1e6:.2f} million a second and core")
    print(f"entries    {entries / n:.0f} a row, {rays / entries:.1f} rays an entry; {G.nbytes / n:.0f} bytes a row")


def bytes_of_scene() -> None:
    def used(dask_worker):
        return dask_worker.monitor.get_process_memory()

    with cluster(1, 1) as workers, Client(workers) as client:
        small, large = (box_of(patches) for patches in (1_000, 100_000))
        held = []
        for scene in (small, large):
            F = rad.distributed.form_factors(scene, client, 0.99, blocks=scene.n_patches // 500, progress=False)
            held.append(next(iter(client.run(used).values())) - F.nbytes)
    per_patch = (held[1] - held[0]) / (large.n_patches - small.n_patches)
    print(f"scene      {per_patch:.0f} bytes a patch on a worker, beside its rows")


def main() -> None:
    overhead(box_of(PATCHES_WIDE))
    two_workers()
    bytes_of_scene()


if __name__ == "__main__":
    main()
