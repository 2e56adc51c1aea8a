"""Form factors on a Dask cluster of this machine: what Dask adds to a product, and local against two workers.

The overhead is the time of a whole product F @ x between two plates that hardly see each other: there is little to sum,
and the messages are those of any other scene of as many patches. Then assembly and solve of a box: one machine against
two workers. Last, the constants of the plan in `docs/distributed.md`.
"""

import math
import os
import time

import numpy as np
from distributed import Client, LocalCluster

import radiosity as rad

# Two unit plates at a distance of 3, where 2 to 4 % of the rays arrive: 4 k^2 patches.
GAP, SQUARES, LOOSE = 3.0, 71, 0.2
# Rows that take rays, which is the time of an assembly.
BOX_EDGE, TIGHT = 0.06, 0.3
PRODUCTS = 41
# Of one machine and two workers, by turns.
TURNS = 3
NAMES = ("one machine", "two workers")
# The plan: (patches, bytes and cores of a machine); so many rays a patch, each of which meets another; 10 Gbit/s.
PLAN = ((10_000_000, 64e9, 16), (1_000_000_000, 512e9, 64))
RAYS, BANDS, LINK, SHARE = 1024, 3, 1.25e9, 0.7


def cluster(workers, threads):
    return LocalCluster(
        n_workers=workers,
        threads_per_worker=threads,
        host="127.0.0.1",
        dashboard_address="127.0.0.1:0",
        silence_logs=60,
    )


def some_light(scene):
    return np.random.default_rng(0).uniform(size=(scene.n_patches, 3))


def seconds(work):
    start = time.perf_counter()
    return work(), time.perf_counter() - start


def plates(k, gap):
    """Two unit squares face to face, of k x k squares of two triangles each."""
    side = np.linspace(0.0, 1.0, k + 1)
    corners = np.stack(np.meshgrid(side, side, [0.0, gap], indexing="ij"), axis=-1).reshape(-1, 3)
    number = np.arange(len(corners)).reshape(k + 1, k + 1, 2)
    a, b, c, d = number[:-1, :-1], number[1:, :-1], number[1:, 1:], number[:-1, 1:]
    up, down = ([a, b, c], [a, c, d]), ([a, c, b], [a, d, c])
    faces = [np.stack([corner[..., z].ravel() for corner in face], 1) for z in (0, 1) for face in (up, down)[z]]
    return rad.Scene(corners, np.concatenate(faces))


def overhead() -> None:
    scene = plates(SQUARES, GAP)
    x = some_light(scene)
    print(f"{scene.n_patches} patches, 3 bands, 4 workers: milliseconds of {PRODUCTS} products")
    print(f"{'':26s} {'median':>7s} {'least':>7s} {'most':>7s}")
    with cluster(4, 1) as workers:
        for name, direct in (("by way of the scheduler", False), ("direct_to_workers=True", True)):
            with Client(workers, direct_to_workers=direct) as client:
                F = rad.distributed.form_factors(scene, client, LOOSE, progress=False)
                spent = 1e3 * np.array([seconds(lambda f=F: f @ x)[1] for _ in range(PRODUCTS)])
                print(f"{name:26s} {np.median(spent):7.1f} {spent.min():7.1f} {spent.max():7.1f}")


def two_workers() -> tuple[float, float]:
    """Rays a second and core, seconds an entry of a product on one core."""
    scene = rad.scenes.cornell_box(max_edge=BOX_EDGE)
    cores = os.cpu_count() or 2
    print(f"\n{scene.n_patches} patches, row tolerance {TIGHT:g}, {cores} cores: seconds, and ratio to one machine")
    print(f"{'':26s} {'assembly':>9s} {'solve':>7s} {'both':>7s} {'ratio':>6s}")

    def solve(F):
        return rad.solve_system(F, scene.emission, scene.reflectance, "gmres", progress=False)

    n, spent = scene.n_patches, []
    with cluster(2, max(cores // 2, 1)) as workers, Client(workers) as client:
        for _ in range(TURNS):
            F, assembly = seconds(lambda: rad.form_factors(scene, TIGHT, "monte_carlo", progress=False))
            expected, solving = seconds(lambda f=F: solve(f))
            G, assembly_there = seconds(lambda: rad.distributed.form_factors(scene, client, TIGHT, progress=False))
            told, solving_there = seconds(lambda f=G: solve(f))
            assert np.array_equal(told.radiosity, expected.radiosity)
            spent.append([(assembly, solving), (assembly_there, solving_there)])
        # (who, what) medians.
        medians = np.median(spent, axis=0)
        both = medians.sum(axis=1)
        for name, (a, b), sum_, ratio in zip(NAMES, medians, both, both / both[0], strict=True):
            print(f"{name:26s} {a:9.2f} {b:7.2f} {sum_:7.2f} {ratio:6.2f}")
        rays, per_core = F.segments, F.segments / medians[0, 0] / cores
        entries = (G.nbytes - 12 * n) / 12
    x = some_light(scene)
    product = np.median([seconds(lambda: F @ x)[1] for _ in range(PRODUCTS)])
    print(f"\nrays       {rays / n:.0f} a patch, {per_core / 1e6:.2f} million a second and core")
    print(f"rows       {entries / n:.0f} entries, {G.nbytes / n:.0f} bytes each")
    print(f"products   {1e9 * product * cores / entries:.2f} ns an entry and core, 3 bands")
    return per_core, product * cores / entries


def bytes_of_scene() -> float:
    def used(dask_worker):
        return dask_worker.monitor.get_process_memory()

    with cluster(1, 1) as workers, Client(workers) as client:
        small, large = plates(20, 100.0), plates(140, 100.0)
        held = []
        for scene in (small, large):
            F = rad.distributed.form_factors(scene, client, LOOSE, progress=False)
            held.append(next(iter(client.run(used).values())) - F.nbytes)
    per_patch = (held[1] - held[0]) / (large.n_patches - small.n_patches)
    print(f"scene      {per_patch:.0f} bytes a patch on a worker, beside its rows")
    return per_patch


def plan(per_core, of_entry, per_patch) -> None:
    """What larger scenes would take if all went on as measured here."""
    print(f"\nplan: {RAYS} rays a patch, {BANDS} bands, {8 * LINK / 1e9:.0f} Gbit/s")
    for n, memory, cores in PLAN:
        rows, scene, x = n * (12.0 * RAYS + 12.0), n * per_patch, 8.0 * BANDS * n
        machines = math.ceil(rows / (SHARE * memory - scene))
        work = n * RAYS / (machines * cores)
        print(
            f"{n:,} patches, machines of {memory / 1e9:.0f} GB and {cores} cores\n"
            f"  rows {rows / 1e9:.0f} GB, scene {scene / 1e9:.1f} GB a machine: {machines} machines\n"
            f"  assembly {work / per_core:.0f} s, product {work * of_entry:.1f} s\n"
            f"  traffic of a product {machines * x / 1e9:.1f} GB out, {x / 1e9:.2f} GB back: "
            f"{(machines + 1) * x / LINK:.1f} s on the driver's link, {2 * x / LINK:.1f} s if it sent x once\n"
            f"  a vector of the error estimate's 18 columns {18 * 8 * n / 1e9:.1f} GB on the driver"
        )


def main() -> None:
    overhead()
    plan(*two_workers(), bytes_of_scene())


if __name__ == "__main__":
    main()
