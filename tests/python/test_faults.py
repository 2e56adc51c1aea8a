"""Memory and disks that are too small, damaged files, Ctrl-C at any moment, threads and processes at once."""

import contextlib
import errno
import io
import json
import multiprocessing
import os
import subprocess
import sys
import textwrap
import threading
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pytest

import radiosity as rad

CORPUS = Path(__file__).parents[1] / "data" / "corpus"
POSIX = pytest.mark.skipif(sys.platform == "win32", reason="limits, signals and forks are the POSIX ones")
LINUX = pytest.mark.skipif(sys.platform != "linux", reason="limits on memory hold on Linux only")

# Every kind of long work, as a program that has imported numpy and radiosity.
WORK = {
    "dense": "rad.form_factors(rad.scenes.cornell_box(max_edge=0.06), 0.05, **quiet)",
    "monte_carlo": "rad.form_factors(rad.scenes.cornell_box(max_edge=0.08), 0.3, 'monte_carlo', **quiet)",
    "links": "rad.form_factors(rad.scenes.cornell_box(max_edge=0.06), 0.5, 'hierarchical', **quiet)",
    "rays": "rad.solve(rad.scenes.cornell_box(max_edge=0.06), 0.06, **quiet)",
    "hierarchical": "rad.solve(rad.scenes.cornell_box(), 0.05, 'hierarchical', **quiet)",
    "direct": "rad.solve_system(np.full((1500, 1500), 1 / 1500), 1.0, 0.5, 'direct', **quiet)",
    "picture": "rad.render(lit, down, 1000, 1000, 'flat', **quiet)",
    "gather": "rad.render(lit, down, 120, 120, 'gather', 0.03, **quiet)",
    "two_pass": "rad.two_pass(lit, down, 120, 120, 0.03, **quiet)",
    "instant": "rad.instant(room, down, 120, 120, 1000, **quiet)",
    "subdivide": "room.subdivide(0.005)",
    "rays_of_the_user": "room.intersect(np.full((2000000, 3), 0.5), np.ones((2000000, 3)))",
}
HEAD = """
import os, random, resource, signal, sys, time
import numpy as np
import radiosity as rad
quiet = {"progress": False}
room = rad.scenes.furnace(0.5, 1.0)
down = rad.Camera((0.5, 0.5, 0.9), (0.5, 0.6, 0.0))
"""


def run_program(text, *arguments, timeout=500):
    """What a Python program of its own prints; anything but a sound end fails."""
    command = [sys.executable, "-W", "ignore", "-c", HEAD + textwrap.dedent(text), *arguments]
    process = subprocess.run(command, capture_output=True, text=True, timeout=timeout)
    assert process.returncode == 0, process.stderr[-2000:]
    return process.stdout


@LINUX
def test_too_little_memory_is_a_memory_error_and_never_the_end_of_the_process():
    # A fork for every work and limit, made before the first thread of the core.
    program = f"""
        _, most = resource.getrlimit(resource.RLIMIT_AS)
        for name, work in {WORK}.items():
            for megabytes in (1, 30, 90):
                child = os.fork()
                if child == 0:
                    pages = int(open("/proc/self/statm").read().split()[0])
                    resource.setrlimit(resource.RLIMIT_AS, (pages * resource.getpagesize() + (megabytes << 20), most))
                    status = 4
                    try:
                        lit = rad.solve(room, 0.3, **quiet)
                        eval(work)
                        status = 0
                    except MemoryError:
                        status = 3
                    finally:
                        # Where there is memory again, the next call works.
                        resource.setrlimit(resource.RLIMIT_AS, (most, most))
                        sums = rad.form_factors(room, **quiet).row_sums
                        os._exit(status if abs(sums - 1.0).max() < 1e-2 else 5)
                print(name, megabytes, os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]), flush=True)
    """
    lines = [line.split() for line in run_program(program).splitlines()]
    assert len(lines) == 3 * len(WORK)
    # 3 is a MemoryError, what is negative a signal.
    assert [line for line in lines if line[2] not in ("0", "3")] == []
    assert sum(line[2] == "3" for line in lines) > len(WORK)


@POSIX
@pytest.mark.parametrize("name", ["a.npz", "a.glb", "a.ply", "a.vtu", "a.vtk", "a.png", "a.exr", "a.html"])
@pytest.mark.parametrize("fault", ["full", "forbidden"])
def test_a_file_that_cannot_be_written_leaves_the_old_one_whole(tmp_path, name, fault):
    folder = tmp_path / "folder"
    folder.mkdir()
    path = folder / name
    path.write_text("old", encoding="ascii")
    solution = rad.solve(rad.scenes.furnace(0.5, 1.0), 0.3, progress=False)

    def write(path):
        if path.suffix in (".png", ".exr"):
            rad.save_image(path, np.random.default_rng(0).random((40, 40, 3)))
        elif path.suffix == ".html":
            rad.show(solution).save(path)
        else:
            rad.save(solution, path)

    # What is imported on the way is, then.
    write(tmp_path / name)
    child = os.fork()
    if child == 0:
        status = 1
        try:
            import resource

            os.chdir(folder)
            if fault == "full":
                resource.setrlimit(resource.RLIMIT_FSIZE, (100, 100))
            else:
                folder.chmod(0o555)
                if os.geteuid() == 0:
                    # Nothing is forbidden to root.
                    os.seteuid(65534)
            write(Path(name))
        except OSError as error:
            status = 0 if fault == "full" or error.errno == errno.EACCES else 2
        finally:
            os._exit(status)
    assert os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == 0, "no OSError, or another one"
    folder.chmod(0o755)
    assert [entry.name for entry in folder.iterdir()] == [name]
    assert path.read_text(encoding="ascii") == "old"


@pytest.mark.parametrize("name", ["rays.npz", "hierarchical.npz"])
def test_a_cut_or_edited_solution_is_refused_or_says_the_same(tmp_path, name):
    data = (CORPUS / name).read_bytes()
    sound = rad.load_solution(CORPUS / name)
    path = tmp_path / name
    step = len(data) // 250
    for k in range(0, len(data), step):
        path.write_bytes(data[:k])
        with pytest.raises(ValueError, match=name):
            rad.load_solution(path)
        edited = bytearray(data)
        edited[k] ^= 0x55
        path.write_bytes(edited)
        # Times and the like may differ, and names that nobody asks for; every number is under a checksum.
        with contextlib.suppress(ValueError):
            loaded = rad.load_solution(path)
            assert np.array_equal(loaded.radiosity, sound.radiosity)
            assert np.array_equal(loaded.scene.vertices, sound.scene.vertices)


@pytest.mark.parametrize("name", ["gltf.glb", "trimesh.glb"])
def test_a_glb_file_cut_anywhere_is_refused(tmp_path, name):
    data = (CORPUS / name).read_bytes()
    path = tmp_path / name
    for k in range(0, len(data), 3):
        path.write_bytes(data[:k])
        with pytest.raises(ValueError, match=name):
            rad.load(path)


def test_pickles_in_a_solution_are_never_loaded(tmp_path):
    class Trap:
        def __reduce__(self):
            return os.mkdir, (str(tmp_path / "sprung"),)

    with np.load(CORPUS / "rays.npz") as file:
        arrays = {name: file[name] for name in file.files}
    for name in ("radiosity", "names", "report", "version"):
        buffer = io.BytesIO()
        np.savez(buffer, **{**arrays, name: np.array([Trap()], dtype=object)})
        (tmp_path / "trap.npz").write_bytes(buffer.getvalue())
        with pytest.raises(ValueError, match=r"trap\.npz"):
            rad.load_solution(tmp_path / "trap.npz")
    assert not (tmp_path / "sprung").exists()


@pytest.mark.parametrize("residual", ["small", None, [], 10**400])
def test_an_edited_report_is_refused(residual, tmp_path):
    with np.load(CORPUS / "rays.npz") as file:
        arrays = {name: file[name] for name in file.files}
    report = json.loads(str(arrays["report"]))
    arrays["report"] = np.array(json.dumps({**report, "residual": residual}))
    np.savez(tmp_path / "edited.npz", **arrays)
    with pytest.raises(ValueError, match=r"edited\.npz"):
        rad.load_solution(tmp_path / "edited.npz")


@POSIX
@pytest.mark.parametrize("work", [*WORK, "save", "load"])
def test_ctrl_c_at_any_moment_ends_the_call_and_nothing_else(work, tmp_path):
    calls = WORK | {
        "save": "rad.save(lit, sys.argv[1] + '/a.npz')",
        "load": "rad.load_solution(sys.argv[1] + '/sound.npz')",
    }
    program = f"""
        lit = rad.solve(room, 0.3, **quiet)
        rad.save(lit, sys.argv[1] + "/sound.npz")
        sound = rad.form_factors(room, **quiet).toarray()
        # The handler of Ctrl-C, set off by a clock: at the same places as by the keyboard.
        signal.signal(signal.SIGALRM, signal.default_int_handler)
        chance = random.Random(5)
        late = stopped = 0
        for attempt in range(12):
            try:
                wait = chance.uniform(1e-4, 0.25) if attempt % 3 else chance.uniform(1e-5, 2e-3)
                due = time.perf_counter() + wait
                signal.setitimer(signal.ITIMER_REAL, wait)
                {calls[work]}
                signal.setitimer(signal.ITIMER_REAL, 0)
            except KeyboardInterrupt:
                late = max(late, time.perf_counter() - due)
                stopped += 1
        assert np.array_equal(rad.form_factors(room, **quiet).toarray(), sound)
        assert rad.load_solution(sys.argv[1] + "/sound.npz").radiosity.shape == lit.radiosity.shape
        print(late, stopped)
    """
    late, stopped = (float(word) for word in run_program(program, str(tmp_path)).split())
    # A second as promised, and one more for a machine with other things to do.
    assert late < 2.0
    assert stopped > 0
    names = {entry.name for entry in tmp_path.iterdir()}
    assert names <= {"sound.npz", "a.npz"}
    if "a.npz" in names:
        rad.load_solution(tmp_path / "a.npz")


def test_eight_threads_at_once_get_what_one_gets():
    scene = rad.scenes.cornell_box(max_edge=0.3)
    camera = rad.Camera(**rad.scenes.cornell_box_view())
    calls = [
        lambda scene: rad.form_factors(scene, 0.05, progress=False).toarray(),
        lambda scene: rad.solve(scene, 0.1, progress=False).radiosity,
        lambda scene: rad.instant(scene, camera, 16, 16, 32, progress=False),
        lambda scene: rad.render(rad.solve(scene, 0.1, progress=False), camera, 16, 16, progress=False),
    ]
    alone = [call(scene) for call in calls]
    # A scene that no thread has used yet: its tree is built by whoever comes first.
    fresh = rad.scenes.cornell_box(max_edge=0.3)
    start = threading.Barrier(8)

    def work(k):
        start.wait()
        return [(j, calls[j](fresh)) for j in ((k + i) % len(calls) for i in range(len(calls)))]

    with ThreadPoolExecutor(8) as pool:
        for results in pool.map(work, range(8)):
            for j, result in results:
                assert np.array_equal(result, alone[j])


def _computed(seed):
    room = rad.scenes.furnace(0.5, 1.0, max_edge=0.5)
    F = rad.form_factors(room, seed=seed, progress=False)
    solution = rad.solve(room, 0.1, seed=seed, progress=False)
    camera = rad.Camera((0.5, 0.5, 0.9), (0.5, 0.6, 0.0))
    picture = rad.render(solution, camera, 8, 8, "smooth", progress=False)
    return F.row_sums, F.reciprocity_error(), solution.radiosity, picture


@pytest.mark.parametrize("way", [pytest.param("fork", marks=LINUX), "spawn"])
@pytest.mark.filterwarnings("ignore:This process:DeprecationWarning")
def test_processes_get_what_their_parent_gets(way):
    # The parent has used its pool of threads: a fork has its memory, but not its threads.
    expected = [_computed(seed) for seed in range(4)]
    with multiprocessing.get_context(way).Pool(2) as pool:
        for one, other in zip(pool.map_async(_computed, range(4)).get(timeout=120), expected, strict=True):
            assert all(np.array_equal(mine, theirs) for mine, theirs in zip(one, other, strict=True))


EVERYTHING = """
import hashlib
quiet = {"progress": False}
box, view = rad.scenes.cornell_box(max_edge=0.3), rad.Camera(**rad.scenes.cornell_box_view())
F = rad.form_factors(box, 0.05, **quiet)
lit, far = rad.solve(box, 0.1, **quiet), rad.solve(box, 0.2, "hierarchical", **quiet)
results = {
    "dense": F.toarray(),
    "balanced": F @ box.emission,
    "monte_carlo": rad.form_factors(box, 0.3, "monte_carlo", **quiet).toarray(),
    "hemicube": rad.form_factors(box, 0.3, "hemicube", **quiet).toarray(),
    "links": rad.form_factors(box, 0.5, "hierarchical", **quiet) @ box.emission,
    "rays": lit.radiosity,
    "hierarchical": far.elements.radiosity,
    **{name: rad.solve_system(F, box.emission, box.reflectance, name, **quiet).radiosity
       for name in ("direct", "jacobi", "gauss_seidel", "southwell", "overshooting", "gmres")},
    "flat": rad.render(lit, view, 20, 20, "flat", **quiet),
    "smooth": rad.render(lit, view, 20, 20, "smooth", **quiet),
    "gather": rad.render(lit, view, 20, 20, "gather", 0.2, **quiet),
    "instant": rad.instant(box, view, 20, 20, 64, **quiet),
}
mirrors = rad.scenes.mirror_and_glass(max_edge=0.5)
solved = rad.solve(mirrors, 0.1, **quiet)
results["mirrors"] = solved.radiosity
results["two_pass"] = rad.two_pass(solved, rad.Camera(**rad.scenes.mirror_and_glass_view()), 20, 20, 0.2, **quiet)
for name, result in results.items():
    print(name, hashlib.sha256(np.ascontiguousarray(result).tobytes()).hexdigest())
"""


def test_the_same_bits_in_processes_of_1_2_and_5_threads(monkeypatch):
    printed = []
    for threads in ("1", "2", "5"):
        monkeypatch.setenv("RAYON_NUM_THREADS", threads)
        printed.append(run_program(EVERYTHING).splitlines())
    assert len(printed[0]) == 19
    assert printed[1] == printed[0]
    assert printed[2] == printed[0]
