"""Form factors on a Dask cluster: the bits of one machine, workers that are lost, clusters that cannot do it."""

import gc
import os
import signal
import sys
import threading
import time

import numpy as np
import pytest
from distributed import Client, LocalCluster

import radiosity as rad

TOLERANCE = 0.3


def local_cluster(workers, **options):
    return LocalCluster(
        n_workers=workers,
        threads_per_worker=1,
        host="127.0.0.1",
        dashboard_address="127.0.0.1:0",
        silence_logs=60,
        **options,
    )


@pytest.fixture(scope="module")
def cluster():
    """Grows as tests need it: starting a worker takes seconds."""
    with local_cluster(1) as cluster:
        yield cluster


@pytest.fixture
def client(cluster):
    with Client(cluster) as client:
        yield client


@pytest.fixture(scope="module")
def room():
    """An open box in three bands, and its factors on this machine: some rays leave, as in all that is counted apart."""
    scene = rad.scenes.cornell_box(max_edge=0.2)
    return scene, {
        method: rad.form_factors(scene, TOLERANCE, method, seed=3, progress=False) for method in rad.distributed.METHODS
    }


def distributed(scene, client, **options):
    return rad.distributed.form_factors(scene, client, TOLERANCE, seed=3, progress=False, **options)


def some_light(scene, shape=()):
    return np.random.default_rng(5).uniform(size=(scene.n_patches, *shape))


def assert_same_solution(F, local, scene, method):
    told, expected = (
        rad.solve_system(f, scene.emission, scene.reflectance, method, 1e-8, progress=False) for f in (F, local)
    )
    for name in ("radiosity", "irradiance", "standard_error"):
        assert np.array_equal(getattr(told, name), getattr(expected, name)), name
    assert told.error_estimate == expected.error_estimate
    assert [step.residual for step in told.history] == [step.residual for step in expected.history]
    assert all(np.array_equal(a.unshot, b.unshot) for a, b in zip(told.history, expected.history, strict=True))
    assert told.report.audit.imbalance == expected.report.audit.imbalance
    assert told.report.row_error == expected.report.row_error
    assert told.report.segments == expected.report.segments
    assert told.scene is scene


# In rising order: the cluster only grows.
@pytest.mark.parametrize(
    ("workers", "blocks", "method"),
    [(1, 1, "monte_carlo"), (1, 5, "hemicube"), (2, None, "hemicube"), (2, 3, "monte_carlo"), (4, None, "monte_carlo")],
)
def test_bits_are_those_of_one_machine(cluster, client, room, workers, blocks, method):
    scene, local = room
    local = local[method]
    cluster.scale(workers)
    client.wait_for_workers(workers, timeout=60)
    F = distributed(scene, client, method=method, blocks=blocks)
    assert F.shape == local.shape
    assert np.array_equal(F.areas, local.areas)
    assert np.array_equal(F.row_sums, local.row_sums)
    assert np.array_equal(F.remainder, local.remainder)
    assert (F.error_estimate, F.segments) == (local.error_estimate, local.segments)
    # One machine keeps the columns, too, and the areas.
    assert 0 < F.nbytes < local.nbytes
    assert sum(F.held.values()) == F.nbytes
    for shape in ((), (0,), (1,), (3,)):
        x = some_light(scene, shape)
        assert np.array_equal(F @ x, local @ x)
    n = scene.n_patches
    assert all(np.array_equal(F.row(i), local.row(i)) for i in (0, n // 2, n - 1))
    for solver in rad.distributed.SOLVERS:
        assert_same_solution(F, local, scene, solver)


def test_an_address_will_do_and_progress_counts_rows(cluster, room):
    scene, local = room
    seen = []
    F = rad.distributed.form_factors(
        scene, cluster.scheduler_address, TOLERANCE, seed=3, progress=lambda done, total: seen.append((done, total))
    )
    x = some_light(scene)
    assert np.array_equal(F @ x, local["monte_carlo"] @ x)
    assert seen == sorted(seen)
    assert seen[-1] == (scene.n_patches, scene.n_patches)


def test_bounces_are_drawn_from_it(client, room):
    scene, local = room
    F = distributed(scene, client)
    steps, expected = (list(rad.bounces(f, method="jacobi")) for f in (F, local["monte_carlo"]))
    assert len(steps) == len(expected)
    assert all(np.array_equal(a.radiosity, b.radiosity) for a, b in zip(steps, expected, strict=True))


def wait_for_actors(client, count):
    """Waits until every worker has so many: the scheduler passes on what nobody needs any more."""
    gc.collect()
    end = time.monotonic() + 10
    while set(client.run(lambda dask_worker: len(dask_worker.state.actors)).values()) != {count}:
        assert time.monotonic() < end
        time.sleep(0.05)


def test_workers_let_go_of_what_nobody_needs(client, room):
    wait_for_actors(client, 0)
    F = distributed(room[0], client)
    wait_for_actors(client, 1)
    del F
    wait_for_actors(client, 0)


def test_a_tolerance_that_is_not_met_is_told(client):
    scene = rad.scenes.furnace()
    with pytest.warns(UserWarning, match="above the tolerance 1e-09: a patch gets no more than 1,048,576 rays"):
        rad.distributed.form_factors(scene, client, 1e-9, progress=False)


def processes(cluster):
    return [nanny.process.pid for nanny in cluster.workers.values()]


@pytest.fixture
def mortal():
    """A cluster of two workers, which may be killed."""
    with local_cluster(2) as cluster, Client(cluster) as client:
        yield cluster, client


@pytest.mark.skipif(sys.platform == "win32", reason="there is no SIGKILL")
def test_workers_that_are_lost_change_nothing(mortal, room):
    cluster, client = mortal
    scene, local = room
    local = local["monte_carlo"]
    x = some_light(scene, (3,))
    killed = []

    def kill_one(done, total):
        if not killed:
            killed.append(processes(cluster)[0])
            os.kill(killed[0], signal.SIGKILL)

    # In the middle of the assembly: the first block is done, others are not.
    F = rad.distributed.form_factors(scene, client, TOLERANCE, seed=3, progress=kill_one)
    assert killed
    assert np.array_equal(F @ x, local @ x)
    # Between two products: a worker with half of the blocks, the only one to have them.
    client.wait_for_workers(2, timeout=60)
    F = distributed(scene, client)
    assert len(F.held) == 2
    os.kill(processes(cluster)[1], signal.SIGKILL)
    assert np.array_equal(F @ x, local @ x)
    # In the middle of a solve.
    client.wait_for_workers(2, timeout=60)
    F = distributed(scene, client)
    pids = processes(cluster)

    def kill(step, radiosity, unshot):
        if step == 3:
            os.kill(pids[0], signal.SIGKILL)

    told = rad.solve_system(F, scene.emission, scene.reflectance, "gmres", on_iteration=kill, progress=False)
    expected = rad.solve_system(local, scene.emission, scene.reflectance, "gmres", progress=False)
    assert np.array_equal(told.radiosity, expected.radiosity)
    assert told.error_estimate == expected.error_estimate
    # All of them, and the scene with them.
    client.wait_for_workers(2, timeout=60)
    for pid in processes(cluster):
        os.kill(pid, signal.SIGKILL)
    assert np.array_equal(F @ x, local @ x)
    assert np.array_equal(F.row(7), local.row(7))


@pytest.mark.parametrize("what", ["client", "cluster"])
def test_a_cluster_that_is_gone_is_told_and_ends_a_solve(room, what):
    scene, _ = room
    with local_cluster(1) as cluster, Client(cluster) as client:
        F = distributed(scene, client)

        def close(step, radiosity, unshot):
            {"client": client, "cluster": cluster}[what].close()

        with pytest.raises(ConnectionError, match="the cluster is gone"):
            rad.solve_system(F, scene.emission, scene.reflectance, "jacobi", on_iteration=close, progress=False)
        with pytest.raises(ConnectionError, match="the cluster is gone"):
            F @ some_light(scene)


def test_an_exception_in_a_callback_leaves_the_cluster_usable(client, room):
    scene, local = room

    def refuse(*_):
        raise RuntimeError("stop it")

    with pytest.raises(RuntimeError, match="stop it"):
        rad.distributed.form_factors(scene, client, TOLERANCE, seed=3, progress=refuse)
    F = distributed(scene, client)
    with pytest.raises(RuntimeError, match="stop it"):
        rad.solve_system(F, scene.emission, scene.reflectance, "gmres", on_iteration=refuse, progress=False)
    assert_same_solution(F, local["monte_carlo"], scene, "gmres")


@pytest.mark.skipif(sys.platform == "win32", reason="signals are sent by the POSIX way")
def test_ctrl_c_ends_an_assembly_within_a_second_and_the_workers_with_it(client, room):
    scene = rad.scenes.cornell_box(max_edge=0.05)
    sent = []

    def interrupt():
        sent.append(time.monotonic())
        os.kill(os.getpid(), signal.SIGINT)

    timer = threading.Timer(3.0, interrupt)
    timer.start()
    # Minutes of work. The forecast alone takes less than three seconds.
    with pytest.raises(KeyboardInterrupt):
        rad.distributed.form_factors(scene, client, 0.02, progress=False)
    assert time.monotonic() - sent[0] < 1.0
    # Were the workers still at it, these would wait for their threads.
    F = distributed(room[0], client)
    x = some_light(room[0])
    assert np.array_equal(F @ x, room[1]["monte_carlo"] @ x)


def test_bad_arguments_are_refused_before_any_work(client, room):
    scene, _ = room
    with pytest.raises(TypeError, match=r"scene must be a radiosity\.Scene"):
        rad.distributed.form_factors(scene.vertices, client)
    with pytest.raises(TypeError, match=r"client must be a synchronous distributed\.Client or an address, not int"):
        rad.distributed.form_factors(scene, 8786)
    for method in ("analytic", "auto", "hierarchical"):
        with pytest.raises(ValueError, match=f"unknown method '{method}'; the methods of distributed.form_factors"):
            rad.distributed.form_factors(scene, client, method=method)
    for tolerance in (0.0, 1.0, float("nan")):
        with pytest.raises(ValueError, match=r"is outside \[1e-10, 1\)"):
            rad.distributed.form_factors(scene, client, tolerance, progress=False)
    with pytest.raises(ValueError, match="seed -1 is outside"):
        rad.distributed.form_factors(scene, client, seed=-1)
    for blocks in (0, scene.n_patches + 1):
        with pytest.raises(ValueError, match=f"blocks {blocks} is outside 1 .. {scene.n_patches}"):
            rad.distributed.form_factors(scene, client, blocks=blocks)
    mirror = scene.with_materials(mirror=np.where(np.arange(scene.n_patches) == 3, 0.9, 0.0))
    with pytest.raises(ValueError, match="patch 3"):
        rad.distributed.form_factors(mirror, client, progress=False)


def test_what_the_factors_cannot_do_is_told(client, room):
    scene, _ = room
    F = distributed(scene, client)
    for method in ("direct", "gauss_seidel", "southwell", "overshooting", "nonsense"):
        with pytest.raises(ValueError, match=r"solvers for distributed form factors are \('jacobi', 'gmres'\)"):
            rad.solve_system(F, scene.emission, scene.reflectance, method)
    with pytest.raises(ValueError, match=r"x must have shape \(\d+,\) or \(\d+, k\)"):
        F @ np.ones(3)
    for i in (-1, scene.n_patches):
        with pytest.raises(IndexError, match=f"row {i} is outside"):
            F.row(i)


def test_a_scheduler_that_does_not_answer_is_told(room, monkeypatch):
    monkeypatch.setattr(rad.distributed, "_CONNECT", 0.5)
    with pytest.raises(ConnectionError, match=r"no scheduler answers at 'tcp://127\.0\.0\.1:9'"):
        rad.distributed.form_factors(room[0], "tcp://127.0.0.1:9")


def test_a_cluster_without_workers_is_told(room):
    with local_cluster(0) as cluster, Client(cluster) as client, pytest.raises(ConnectionError, match="has no workers"):
        distributed(room[0], client)


def test_workers_without_the_package_or_with_another_version_are_named(client, room):
    def become(version):
        import radiosity

        before, radiosity.__version__ = radiosity.__version__, version
        return before

    def hide():
        sys.modules["radiosity_hidden"] = sys.modules.pop("radiosity")
        sys.modules["radiosity"] = None

    def show():
        sys.modules["radiosity"] = sys.modules.pop("radiosity_hidden")

    address = next(iter(client.nthreads()))
    client.run(become, "0.0.9", workers=[address])
    try:
        with pytest.raises(RuntimeError, match=rf"worker {address} has radiosity 0\.0\.9, but {rad.__version__}"):
            distributed(room[0], client)
    finally:
        client.run(become, rad.__version__, workers=[address])
    client.run(hide, workers=[address])
    try:
        with pytest.raises(RuntimeError, match=f"worker {address} cannot import radiosity"):
            distributed(room[0], client)
    finally:
        client.run(show, workers=[address])


def test_workers_that_are_too_small_are_told_before_the_scene_is_sent(room):
    # Room for the worker itself, some 150 MB, and not for rows of some 2,000 entries each.
    with local_cluster(1, memory_limit="300MB") as cluster, Client(cluster) as client:
        scene = rad.scenes.cornell_box(max_edge=0.03)
        with pytest.raises(MemoryError, match=r"need about .* MiB in \d+ blocks .* the 1 workers can take .* more"):
            rad.distributed.form_factors(scene, client, 0.1, progress=False)
        assert not any(client.run(lambda dask_worker: len(dask_worker.state.actors)).values())


def test_the_extra_is_named_where_it_is_missing(room, monkeypatch):
    monkeypatch.setitem(sys.modules, "distributed", None)
    with pytest.raises(ImportError, match=r"pip install 'radiosity\[distributed\]'"):
        rad.distributed.form_factors(room[0], "tcp://127.0.0.1:8786")
