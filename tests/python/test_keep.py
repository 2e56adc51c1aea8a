"""Form factors and solutions that are kept: the same bits again, other scenes and damage refused by name."""

import contextlib
import dataclasses
import errno
import importlib
import json
import multiprocessing
import os
import subprocess
import sys
import textwrap
import warnings

import numpy as np
import pytest

import radiosity as rad
from radiosity.keep import corners_of
from radiosity.npz import Entry, read_arrays, write_arrays

METHODS = {"analytic": 0.05, "monte_carlo": 0.3, "hemicube": 0.3, "hierarchical": 0.5}
POSIX = pytest.mark.skipif(sys.platform == "win32", reason="limits and forks are the POSIX ones")
LINUX = pytest.mark.skipif(sys.platform != "linux", reason="Linux tells what memory is whose")


@pytest.fixture(scope="module")
def box():
    return rad.scenes.cornell_box(max_edge=0.25)


@pytest.fixture(scope="module")
def factors(box):
    return {name: rad.form_factors(box, t, name, seed=3, progress=False) for name, t in METHODS.items()}


def arrays_of(path):
    with np.load(path) as file:
        return {name: file[name] for name in file.files}


def assert_same_operator(G, F):
    """To the last bit, for all that a solver and a user may ask."""
    x = np.random.default_rng(0).random((F.shape[0], 3))
    assert (G.method, G.tolerance, G.seed, G.balanced_by) == (F.method, F.tolerance, F.seed, F.balanced_by)
    assert (G.error_estimate, G.segments, G.nbytes) == (F.error_estimate, F.segments, F.nbytes)
    for one, other in ((G @ x, F @ x), (G.toarray(), F.toarray()), (G.row(7), F.row(7)), (G.row_sums, F.row_sums)):
        np.testing.assert_array_equal(one, other)
    assert G.reciprocity_error() == F.reciprocity_error()
    assert (G.links is None) == (F.links is None)
    if F.links is not None:
        for name in ("order", "ranges", "levels", "visibility"):
            np.testing.assert_array_equal(getattr(G.links, name), getattr(F.links, name))


def assert_same_solution(a, b):
    """All but the scene and the time that it took."""
    for name in ("radiosity", "irradiance", "standard_error"):
        np.testing.assert_array_equal(getattr(a, name), getattr(b, name))
    assert a.error_estimate == b.error_estimate
    for one, other in zip(a.history, b.history, strict=True):
        assert one.residual == other.residual
        np.testing.assert_array_equal(one.unshot, other.unshot)
    parts = [field.name for field in dataclasses.fields(a.report) if field.name not in ("audit", "bound", "seconds")]
    assert [getattr(a.report, name) for name in parts] == [getattr(b.report, name) for name in parts]
    for name in ("emitted", "absorbed", "left", "unshot"):
        np.testing.assert_array_equal(getattr(a.report.audit, name), getattr(b.report.audit, name))


@pytest.mark.parametrize("method", METHODS)
def test_form_factors_come_back_bit_for_bit(method, factors, box, tmp_path):
    F = factors[method]
    F.save(tmp_path / "a.npz")
    for check in (True, False):
        G = rad.load_form_factors(tmp_path / "a.npz", box, check)
        assert G.scene is box
        assert_same_operator(G, F)
        for solver in ("direct", "gauss_seidel", "southwell"):
            one, other = (
                rad.solve_system(each, box.emission, box.reflectance, solver, 1e-4, progress=False) for each in (G, F)
            )
            assert_same_solution(one, other)
            np.testing.assert_array_equal(one.report.bound, other.report.bound)
    # What was loaded is kept in the same bytes.
    G.save(tmp_path / "b.npz")
    assert (tmp_path / "b.npz").read_bytes() == (tmp_path / "a.npz").read_bytes()


def test_balanced_factors_come_back_and_loaded_ones_can_be_balanced(tmp_path):
    room = rad.scenes.furnace(0.5, 1.0, max_edge=0.5)
    F = rad.form_factors(room, 0.01, progress=False)
    F.save(tmp_path / "plain.npz")
    balanced = F.balance()
    balanced.save(tmp_path / "balanced.npz")
    assert balanced.balanced_by is not None
    assert_same_operator(rad.load_form_factors(tmp_path / "balanced.npz", room), balanced)
    assert_same_operator(rad.load_form_factors(tmp_path / "plain.npz", room).balance(), balanced)


def test_one_patch_has_no_pairs_and_is_kept_too(tmp_path):
    one = rad.Scene([[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 1, 2]])
    for method, tolerance in METHODS.items():
        F = rad.form_factors(one, tolerance, method, progress=False)
        F.save(tmp_path / f"{method}.npz")
        G = rad.load_form_factors(tmp_path / f"{method}.npz", one)
        assert G.toarray() == F.toarray() == 0.0


def blocks(sides, heights):
    """Unit boxes half a metre apart, with walls that face outwards or inwards: few pairs of patches see each other."""
    cube = rad.scenes.furnace(0.5, 1.0)
    faces = cube.faces[:, ::-1] if sides == "out" else cube.faces
    corners = [
        cube.vertices * (1.0, 1.0, height) + (1.5 * (k % 3), 1.5 * (k // 3), 0.0) for k, height in enumerate(heights)
    ]
    numbers = np.concatenate([faces + k * len(cube.vertices) for k in range(len(heights))])
    return rad.Scene(np.concatenate(corners), numbers, 0.5, 1.0)


@pytest.fixture(scope="module")
def town():
    """Nine houses of three heights, which hide parts of each other."""
    scene = blocks("out", (1.0, 2.0, 1.0, 3.0, 1.0, 2.0, 1.0, 3.0, 2.0)).subdivide(0.8)
    return scene, rad.form_factors(scene, 0.05, seed=3, progress=False)


def test_what_is_not_zero_comes_back_bit_for_bit(town, tmp_path):
    scene, F = town
    n = scene.n_patches
    F.save(tmp_path / "a.npz")
    arrays = arrays_of(tmp_path / "a.npz")
    start, column, exchange = (arrays[name] for name in ("start", "column", "exchange"))
    assert start.shape == (n + 1,)
    assert column.shape == exchange.shape == (start[-1],)
    # Kept like this only where it saves a quarter; and some of it is sampled.
    assert 20 * len(column) + 16 * (n + 1) <= 0.75 * 8 * (n * (n - 1) // 2)
    assert len(arrays["pairs"])
    lower = np.zeros(F.shape)
    lower[np.repeat(np.arange(n), np.diff(start.astype(int))), column] = exchange
    np.testing.assert_array_equal((lower + lower.T) / scene.areas[:, None], F.toarray())
    for check in (True, False):
        G = rad.load_form_factors(tmp_path / "a.npz", scene, check)
        assert_same_operator(G, F)
        # From both sides, and with many columns.
        x = np.random.default_rng(1).random((n, 40))
        np.testing.assert_array_equal(G @ x, F @ x)
        np.testing.assert_array_equal(G.aslinearoperator().rmatmat(x), F.aslinearoperator().rmatmat(x))
        for solver in ("direct", "gauss_seidel", "southwell", "gmres"):
            one, other = (
                rad.solve_system(each, scene.emission, scene.reflectance, solver, 1e-4, progress=False)
                for each in (G, F)
            )
            assert_same_solution(one, other)
    G.save(tmp_path / "b.npz")
    assert (tmp_path / "b.npz").read_bytes() == (tmp_path / "a.npz").read_bytes()


def test_what_is_not_zero_is_balanced_as_before(tmp_path):
    rooms = blocks("in", [1.0] * 9)
    F = rad.form_factors(rooms, 0.01, progress=False)
    F.save(tmp_path / "plain.npz")
    assert "column" in arrays_of(tmp_path / "plain.npz")
    balanced = F.balance()
    assert balanced.balanced_by is not None
    assert_same_operator(rad.load_form_factors(tmp_path / "plain.npz", rooms).balance(), balanced)
    balanced.save(tmp_path / "balanced.npz")
    assert_same_operator(rad.load_form_factors(tmp_path / "balanced.npz", rooms), balanced)


def test_patches_that_see_nobody_are_kept_too(tmp_path):
    house = blocks("out", [1.0]).subdivide(0.5)
    F = rad.form_factors(house, 0.05, progress=False)
    F.save(tmp_path / "a.npz")
    assert arrays_of(tmp_path / "a.npz")["column"].shape == (0,)
    G = rad.load_form_factors(tmp_path / "a.npz", house)
    assert_same_operator(G, F)
    assert not G.toarray().any()


def set_at(array, k, value):
    array[k] = value
    return array


def first_of_the_longest_row(arrays):
    start = arrays["start"].astype(int)
    return start[np.argmax(np.diff(start))]


def doubled(arrays):
    k = first_of_the_longest_row(arrays)
    return set_at(arrays["column"], k, arrays["column"][k + 1])


PATTERN_EDITS = {
    "the first row starts late": ("start", lambda a: set_at(a["start"], 0, 1)),
    "rows end before they start": ("start", lambda a: set_at(a["start"], 40, a["start"][-1])),
    "rows end before the columns do": ("start", lambda a: set_at(a["start"], -1, len(a["column"]) - 1)),
    "rows end after the columns": ("start", lambda a: set_at(a["start"], -1, len(a["column"]) + 1)),
    "a place that no machine has": ("start", lambda a: set_at(a["start"], -1, 2**64 - 1)),
    "one row too few": ("start", lambda a: a["start"][:-1]),
    "starts of another type": ("start", lambda a: a["start"].astype(np.int64)),
    "a column above the diagonal": ("column", lambda a: set_at(a["column"], -1, len(a["start"]) - 2)),
    "a column that is not there": ("column", lambda a: set_at(a["column"], -1, 2**32 - 1)),
    "columns that descend": ("column", lambda a: a["column"][::-1]),
    "a column twice": ("column", doubled),
    "one column too few": ("column", lambda a: a["column"][:-1]),
    "one exchange too few": ("exchange", lambda a: a["exchange"][:-1]),
}


@pytest.mark.parametrize("edit", PATTERN_EDITS)
def test_places_that_cannot_be_are_refused(edit, town, tmp_path):
    scene, F = town
    F.save(tmp_path / "sound.npz")
    arrays = arrays_of(tmp_path / "sound.npz")
    name, edited = PATTERN_EDITS[edit]
    changed = edited({other: array.copy() for other, array in arrays.items()})
    np.savez(tmp_path / "edited.npz", **{**arrays, name: changed})
    with pytest.raises(ValueError, match=r"edited\.npz: .*(starts? |column|exchange)"):
        rad.load_form_factors(tmp_path / "edited.npz", scene, False)
    for missing in ({name}, {"start", "column"}):
        left = {other: array for other, array in arrays.items() if other not in missing}
        np.savez(tmp_path / "short.npz", **left)
        with pytest.raises(ValueError, match=r"short\.npz: damaged, "):
            rad.load_form_factors(tmp_path / "short.npz", scene)


def test_materials_do_not_matter(factors, box, tmp_path):
    factors["analytic"].save(tmp_path / "a.npz")
    other = box.with_materials(0.3, 2.0)
    G = rad.load_form_factors(tmp_path / "a.npz", other)
    assert G.scene is other
    np.testing.assert_array_equal(G.toarray(), factors["analytic"].toarray())


def test_another_scene_is_refused_by_what_has_changed(factors, box, tmp_path):
    path = tmp_path / "a.npz"
    factors["analytic"].save(path)
    finer = rad.scenes.cornell_box(max_edge=0.2)
    with pytest.raises(ValueError, match=f"a.npz: it is of {box.n_patches} patches and the scene has "):
        rad.load_form_factors(path, finer)

    alone = box.vertices[box.faces].reshape(-1, 3)
    faces = np.arange(len(alone)).reshape(-1, 3)
    moved = alone.copy()
    moved[3 * 17 : 3 * 18, 2] += 0.25
    with pytest.raises(ValueError, match=r"patch 17 was moved, by up to 0\.25 m: compute"):
        rad.load_form_factors(path, rad.Scene(moved, faces))
    moved[3 * 40, 0] += 1e-9
    with pytest.raises(ValueError, match=r"patch 17 was moved, by up to 0\.25 m \(2 patches have changed\)"):
        rad.load_form_factors(path, rad.Scene(moved, faces))
    turned = faces.copy()
    turned[5] = turned[5, ::-1]
    with pytest.raises(ValueError, match="patch 5 has its corners in another order"):
        rad.load_form_factors(path, rad.Scene(alone, turned))
    mirror, ior = np.zeros(box.n_patches), np.full(box.n_patches, np.nan)
    mirror[5], ior[9] = 0.8, 1.5
    with pytest.raises(ValueError, match="patch 5 is a mirror now"):
        rad.load_form_factors(path, box.with_materials(mirror=mirror))
    with pytest.raises(ValueError, match="patch 9 is glass now"):
        rad.load_form_factors(path, box.with_materials(ior=ior))
    # The same corners under other numbers are the same patches.
    np.testing.assert_array_equal(
        rad.load_form_factors(path, rad.Scene(alone, faces)).toarray(), factors["analytic"].toarray()
    )


def test_other_files_are_told_by_name(factors, box, tmp_path):
    rad.save(rad.solve(box, 0.3, progress=False), tmp_path / "solution.npz")
    factors["analytic"].save(tmp_path / "factors.npz")
    with pytest.raises(ValueError, match=r"solution\.npz: no saved form factors \(a saved solution: load_solution"):
        rad.load_form_factors(tmp_path / "solution.npz", box)
    with pytest.raises(ValueError, match=r"factors\.npz: no saved solution \(form factors: load_form_factors reads"):
        rad.load_solution(tmp_path / "factors.npz")
    np.savez(tmp_path / "other.npz", a=1)
    (tmp_path / "text.npz").write_text("hello", encoding="ascii")
    (tmp_path / "empty.npz").write_bytes(b"")
    for name in ("other.npz", "text.npz", "empty.npz"):
        with pytest.raises(ValueError, match=name):
            rad.load_form_factors(tmp_path / name, box)
    with pytest.raises(FileNotFoundError, match="no such file"):
        rad.load_form_factors(tmp_path / "none.npz", box)
    with pytest.raises(ValueError, match=r"saved as \.npz, not '\.glb'"):
        factors["analytic"].save(tmp_path / "a.glb")
    with pytest.raises(TypeError, match=r"scene must be a radiosity\.Scene"):
        rad.load_form_factors(tmp_path / "factors.npz", None)


def test_another_version_is_told(factors, box, tmp_path):
    factors["analytic"].save(tmp_path / "a.npz")
    arrays = arrays_of(tmp_path / "a.npz")
    settings = json.loads(str(arrays["settings"]))
    np.savez(tmp_path / "b.npz", **{**arrays, "settings": json.dumps({**settings, "version": 2, "radiosity": "9.9"})})
    with pytest.raises(ValueError, match=r"written in layout 2 by radiosity '9\.9', and this version reads layout 1"):
        rad.load_form_factors(tmp_path / "b.npz", box)


# Of each method, an array and what it must not be.
EDITS = [
    ("analytic", "exchange", lambda a: a[:-1]),
    ("analytic", "exchange", lambda a: a.astype(np.float32)),
    ("analytic", "pairs", lambda a: a + 1000),
    ("analytic", "pairs", lambda a: a[:, ::-1]),
    ("analytic", "standard_errors", lambda a: a * np.nan),
    ("analytic", "standard_errors", lambda a: a[:-1]),
    ("analytic", "corners", lambda a: a[:-1]),
    ("monte_carlo", "start", lambda a: a[::-1]),
    ("monte_carlo", "start", lambda a: a + 2**63),
    ("monte_carlo", "index", lambda a: a + 10**6),
    ("monte_carlo", "value", lambda a: a - 1.0),
    ("monte_carlo", "rays", lambda a: a * 0),
    ("hemicube", "errors", lambda a: -1.0 - a),
    ("hemicube", "value", lambda a: a * np.nan),
    ("hierarchical", "nodes", lambda a: a + 10**6),
    ("hierarchical", "places", lambda a: a + 10**9),
    ("hierarchical", "places", lambda a: np.full_like(a, 2**64 - 2)),
    ("hierarchical", "visibility", lambda a: a + 3),
    ("hierarchical", "exchanges", lambda a: a * np.inf),
    ("hierarchical", "matrices", lambda a: a[:1]),
    ("hierarchical", "matrices", lambda a: a * np.nan),
]


@pytest.mark.parametrize(("method", "name", "edit"), EDITS)
def test_arrays_that_cannot_be_are_refused(method, name, edit, factors, box, tmp_path):
    factors[method].save(tmp_path / "sound.npz")
    arrays = arrays_of(tmp_path / "sound.npz")
    assert arrays[name].size
    with np.errstate(all="ignore"):
        np.savez(tmp_path / "edited.npz", **{**arrays, name: edit(arrays[name])})
        with pytest.raises(ValueError, match=r"edited\.npz"):
            rad.load_form_factors(tmp_path / "edited.npz", box, False)
    np.savez(tmp_path / "short.npz", **{other: array for other, array in arrays.items() if other != name})
    with pytest.raises(ValueError, match=r"short\.npz: damaged, the arrays are"):
        rad.load_form_factors(tmp_path / "short.npz", box)


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("method", "magic"),
        ("method", "hemicube"),
        ("tolerance", None),
        ("seed", -1),
        ("seed", 0.5),
        ("segments", 2**64),
        ("patches", True),
        ("error_estimate", float("nan")),
        ("kernel_error", -1.0),
        ("kernel_error", "small"),
        ("balanced_by", "far"),
        ("format", "radiosity pictures"),
    ],
)
def test_settings_that_cannot_be_are_refused(name, value, factors, box, tmp_path):
    factors["analytic"].save(tmp_path / "sound.npz")
    arrays = arrays_of(tmp_path / "sound.npz")
    settings = json.loads(str(arrays["settings"]))
    np.savez(tmp_path / "edited.npz", **{**arrays, "settings": json.dumps({**settings, name: value})})
    with pytest.raises(ValueError, match=r"edited\.npz"):
        rad.load_form_factors(tmp_path / "edited.npz", box)
    del settings[name]
    np.savez(tmp_path / "edited.npz", **{**arrays, "settings": json.dumps(settings)})
    with pytest.raises(ValueError, match=r"edited\.npz"):
        rad.load_form_factors(tmp_path / "edited.npz", box)


def test_another_tree_is_refused(factors, box, tmp_path):
    factors["hierarchical"].save(tmp_path / "sound.npz")
    arrays = arrays_of(tmp_path / "sound.npz")
    settings = json.loads(str(arrays["settings"]))
    settings["tree_mark"] ^= 1
    np.savez(tmp_path / "edited.npz", **{**arrays, "settings": json.dumps(settings)})
    with pytest.raises(ValueError, match="the tree over the patches does not come out as it was"):
        rad.load_form_factors(tmp_path / "edited.npz", box)


@pytest.mark.parametrize("method", METHODS)
def test_a_cut_or_edited_file_is_refused_or_says_the_same(method, tmp_path):
    room = rad.scenes.furnace(0.5, 1.0)
    F = rad.form_factors(room, METHODS[method], method, progress=False)
    F.save(tmp_path / "sound.npz")
    data, sound = (tmp_path / "sound.npz").read_bytes(), F.toarray()
    path = tmp_path / "a.npz"
    step = max(len(data) // 400, 1)
    refused = 0
    for k in range(0, len(data), step):
        path.write_bytes(data[:k])
        with pytest.raises(ValueError, match=r"a\.npz"):
            rad.load_form_factors(path, room)
        edited = bytearray(data)
        edited[k] ^= 0x55
        path.write_bytes(edited)
        try:
            np.testing.assert_array_equal(rad.load_form_factors(path, room).toarray(), sound)
        except ValueError:
            refused += 1
        # Unchecked, a number may be another one: everything works on, with that number.
        with contextlib.suppress(ValueError):
            G = rad.load_form_factors(path, room, False)
            assert (G @ np.ones(room.n_patches)).shape == G.row(3).shape == (room.n_patches,)
    # Times of a zip archive, which nobody asks for, and the blanks of headers before a checksum looks at them.
    assert refused > 0.6 * len(range(0, len(data), step))


def test_numpy_reads_and_writes_these_files(factors, box, tmp_path):
    F = factors["analytic"]
    F.save(tmp_path / "a.npz")
    arrays = arrays_of(tmp_path / "a.npz")
    lower = np.zeros(F.shape)
    lower[np.tril_indices(F.shape[0], -1)] = arrays["exchange"]
    np.testing.assert_array_equal((lower + lower.T) / box.areas[:, None], F.toarray())
    np.testing.assert_array_equal(arrays["corners"], corners_of(box))
    # Written by numpy nothing is aligned, and nothing mapped; from another machine the bytes are in another order.
    np.savez(tmp_path / "b.npz", **arrays)
    big = {name: array.astype(array.dtype.newbyteorder(">")) for name, array in arrays.items()}
    np.savez(tmp_path / "c.npz", **big)
    for name in ("b.npz", "c.npz"):
        assert_same_operator(rad.load_form_factors(tmp_path / name, box), F)
    np.savez_compressed(tmp_path / "d.npz", **arrays)
    with pytest.raises(ValueError, match=r"d\.npz: damaged, settings\.npy is compressed"):
        rad.load_form_factors(tmp_path / "d.npz", box)


def test_arrays_are_aligned_and_mapped_and_empty_ones_are_not(tmp_path):
    values = {"one": np.arange(5.0), "other": np.arange(7, dtype=np.uint8), "none": np.zeros((0, 3))}
    write_arrays(str(tmp_path / "a.npz"), [Entry.of(name, array) for name, array in values.items()])
    found = read_arrays(tmp_path / "a.npz", tuple(values), True)
    for name, array in values.items():
        np.testing.assert_array_equal(found[name], array)
        assert not found[name].flags.writeable
        assert isinstance(found[name], np.memmap) == (name != "none")
        if name != "none":
            assert found[name].offset % 64 == 0


@LINUX
def test_a_loaded_matrix_takes_no_memory_of_its_own(tmp_path):
    program = """
        import sys
        import numpy as np
        import radiosity as rad

        def own():
            lines = open("/proc/self/status").read().splitlines()
            return 1024 * next(int(line.split()[1]) for line in lines if line.startswith("RssAnon"))

        room = rad.scenes.furnace(0.5, 1.0, max_edge=0.07)
        if sys.argv[2] == "save":
            rad.form_factors(room, 0.5, progress=False).save(sys.argv[1])
        else:
            one = np.ones(room.n_patches)
            rad.form_factors(rad.scenes.furnace(0.5, 1.0), progress=False) @ np.ones(12)
            before = own()
            F = rad.load_form_factors(sys.argv[1], room)
            sums = F @ one
            print(own() - before, F.nbytes, abs(sums - 1.0).max())
    """
    command = [sys.executable, "-c", textwrap.dedent(program), str(tmp_path / "a.npz")]
    subprocess.run([*command, "save"], check=True, timeout=300)
    printed = subprocess.run([*command, "load"], check=True, timeout=300, capture_output=True, text=True).stdout
    grown, nbytes, error = (float(word) for word in printed.split())
    assert nbytes > 30e6
    # The 32 partial sums of a product take 0.8 MB of it.
    assert grown < 0.2 * nbytes
    # The row tolerance.
    assert error < 0.5


def test_a_file_that_is_replaced_or_deleted_stays_for_who_has_loaded_it(factors, box, tmp_path):
    F = factors["analytic"]
    F.save(tmp_path / "a.npz")
    G = rad.load_form_factors(tmp_path / "a.npz", box)
    rad.form_factors(box, 0.2, seed=9, progress=False).save(tmp_path / "a.npz")
    np.testing.assert_array_equal(G.toarray(), F.toarray())
    G.save(tmp_path / "a.npz")
    assert_same_operator(rad.load_form_factors(tmp_path / "a.npz", box), F)
    (tmp_path / "a.npz").unlink()
    np.testing.assert_array_equal(G.toarray(), F.toarray())


@POSIX
@pytest.mark.parametrize("fault", ["full", "forbidden"])
def test_factors_that_cannot_be_written_leave_the_old_file_whole(fault, factors, box, tmp_path):
    folder = tmp_path / "folder"
    folder.mkdir()
    path = folder / "a.npz"
    path.write_text("old", encoding="ascii")
    child = os.fork()
    if child == 0:
        status = 1
        try:
            import resource

            os.chdir(folder)
            if fault == "full":
                resource.setrlimit(resource.RLIMIT_FSIZE, (1000, 1000))
            else:
                folder.chmod(0o555)
                if os.geteuid() == 0:
                    # Nothing is forbidden to root.
                    os.seteuid(65534)
            try:
                factors["analytic"].save("a.npz")
            except OSError as error:
                status = 0 if fault == "full" or error.errno == errno.EACCES else 2
            # A cache says so before the work, or, of a full disk, after it.
            calls = []
            call = {"cache": ".", "progress": lambda *report: calls.append(report)}
            with warnings.catch_warnings(record=True) as caught:
                warnings.simplefilter("always")
                try:
                    F = rad.form_factors(box, 0.05, seed=3, **call)
                    told = any("the result could not be kept" in str(each.message) for each in caught)
                    same = np.array_equal(F.toarray(), factors["analytic"].toarray())
                    status = status if fault == "full" and told and same else 3
                except PermissionError as error:
                    status = status if "cache cannot be written to" in str(error) and not calls else 4
        finally:
            os._exit(status)
    assert os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == 0
    folder.chmod(0o755)
    assert [entry.name for entry in folder.iterdir()] == ["a.npz"]
    assert path.read_text(encoding="ascii") == "old"


def is_work(call, scene, cache, **arguments):
    """Whether anything was reported by a call."""
    reports = []
    call(scene, progress=lambda *report: reports.append(report), cache=cache, **arguments)
    return bool(reports)


@pytest.mark.parametrize("method", METHODS)
def test_a_cache_of_form_factors_does_the_work_once(method, factors, box, tmp_path):
    folder = tmp_path / "x" / "y"
    arguments = {"tolerance": METHODS[method], "method": method, "seed": 3}
    assert is_work(rad.form_factors, box, folder, **arguments)
    assert not is_work(rad.form_factors, box, folder, **arguments)
    # Other materials, names and threads are the same factors.
    painted = rad.Scene(box.vertices, box.faces, 0.2, 3.0, names=["wall"] * box.n_patches)
    assert not is_work(rad.form_factors, painted, folder, threads=1, **arguments)
    found = rad.form_factors(painted, cache=folder, progress=False, **arguments)
    assert found.scene is painted
    assert_same_operator(found, factors[method])
    assert len(list(folder.iterdir())) == 1


def test_a_change_of_mesh_or_setting_is_a_miss(box, tmp_path):
    moved = box.vertices.copy()
    moved[0, 0] += 2.0**-1000
    calls = [
        (box, {}),
        (box, {"tolerance": 0.2}),
        (box, {"seed": 1}),
        (box, {"method": "hierarchical"}),
        (rad.Scene(moved, box.faces), {}),
        (rad.Scene(box.vertices, np.roll(box.faces, 1, axis=1)), {}),
    ]
    for scene, change in calls:
        assert is_work(rad.form_factors, scene, tmp_path, **{"tolerance": 0.3, **change})
    assert len(list(tmp_path.iterdir())) == len(calls)
    assert not is_work(rad.form_factors, box, str(tmp_path), tolerance=0.3, method="analytic")


@pytest.mark.parametrize("method", ["rays", "dense", "hierarchical"])
def test_a_cache_of_solutions_does_the_work_once(method, box, tmp_path):
    plain = rad.solve(box, 0.2, method, progress=False)
    first = rad.solve(box, 0.2, method, progress=False, cache=tmp_path)
    assert not is_work(rad.solve, box, tmp_path, tolerance=0.2, method=method)
    again = rad.solve(box, 0.2, method, progress=False, cache=tmp_path, threads=1)
    assert again.scene is box
    assert again.report.seconds == first.report.seconds
    for solution in (first, again):
        assert_same_solution(solution, plain)
    if method == "hierarchical":
        assert_same_solution(again.elements, plain.elements)
        np.testing.assert_array_equal(again.elements.scene.parent, plain.elements.scene.parent)


def test_a_change_of_mesh_material_or_setting_is_a_miss(box, tmp_path):
    emission = box.emission.copy()
    emission[0, 0] += 1e-12
    calls = [
        (box, {}),
        (box, {"tolerance": 0.25}),
        (box, {"seed": 1}),
        (box, {"order": 0}),
        (box, {"refine": False}),
        (box.with_materials(emission=emission), {}),
        (box.with_materials(0.9 * box.reflectance), {}),
        (box.with_materials(mirror=np.where(np.arange(box.n_patches) == 3, 0.5, 0.0)), {}),
        (rad.scenes.cornell_box(max_edge=0.2), {}),
    ]
    for scene, change in calls:
        assert is_work(rad.solve, scene, tmp_path, **{"tolerance": 0.3, **change})
    assert len(list(tmp_path.iterdir())) == len(calls)


def test_dense_solves_of_other_materials_share_form_factors(box, tmp_path, monkeypatch):
    rad.solve(box, 0.2, "dense", progress=False, cache=tmp_path)

    def fail(*arguments):
        raise AssertionError("form factors are computed again")

    monkeypatch.setattr(importlib.import_module("radiosity.form_factors"), "_computed", fail)
    painted = box.with_materials(0.1, 2.0 * box.emission)
    solution = rad.solve(painted, 0.2, "dense", progress=False, cache=tmp_path)
    monkeypatch.undo()
    assert_same_solution(solution, rad.solve(painted, 0.2, "dense", progress=False))


def test_bands_that_are_equal_come_back_in_their_places(box, tmp_path):
    grey = box.with_materials(0.5, np.repeat(box.emission[:, :1], 3, axis=1))
    first, again = (rad.solve(grey, 0.3, progress=False, cache=tmp_path) for _ in range(2))
    assert again.radiosity.shape == (box.n_patches, 3)
    assert_same_solution(again, first)


def test_warnings_come_from_the_cache_as_well(box, tmp_path):
    for _ in range(2):
        with pytest.warns(UserWarning, match="the scene has no emission"):
            rad.solve(box.with_materials(emission=0.0), 0.3, progress=False, cache=tmp_path)
        # More rays than a hemicube may cast.
        with pytest.warns(UserWarning, match=r"above the tolerance 0\.04"):
            rad.form_factors(rad.scenes.cornell_box(max_edge=2.0), 0.04, "hemicube", progress=False, cache=tmp_path)


@pytest.mark.parametrize("damage", ["cut", "edited", "empty", "replaced"])
def test_a_damaged_file_of_a_cache_is_computed_again(damage, box, factors, tmp_path):
    def call(kind):
        if kind == "factors":
            return rad.form_factors(box, 0.05, seed=3, progress=False, cache=tmp_path / kind)
        return rad.solve(box, 0.3, progress=False, cache=tmp_path / kind)

    for kind in ("factors", "solution"):
        first = call(kind)
        (path,) = (tmp_path / kind).iterdir()
        data = path.read_bytes()
        middle = len(data) // 2
        damaged = {
            "cut": data[:middle],
            "edited": data[:middle] + bytes([data[middle] ^ 1]) + data[middle + 1 :],
            "empty": b"",
            "replaced": b"hello",
        }
        path.write_bytes(damaged[damage])
        with pytest.warns(UserWarning, match=f"{path.name}.*it is not used"):
            again = call(kind)
        same = assert_same_operator if kind == "factors" else assert_same_solution
        same(again, first)
        # It is whole again: no warning.
        same(call(kind), first)
        assert list((tmp_path / kind).iterdir()) == [path]


def test_a_file_under_the_name_of_another_is_not_used(box, factors, tmp_path):
    for call in (rad.form_factors, rad.solve):
        folder = tmp_path / call.__name__
        call(box, 0.3, progress=False, cache=folder)
        (first,) = folder.iterdir()
        moved = rad.Scene(1.5 * box.vertices, box.faces, box.reflectance, box.emission)
        others = [(moved, 0)] + ([(box, 1)] if call is rad.form_factors else [])
        for scene, seed in others:
            call(scene, 0.3, seed=seed, progress=False, cache=folder)
            for path in folder.iterdir():
                if path != first:
                    path.write_bytes(first.read_bytes())
            with pytest.warns(UserWarning, match="it is not used"):
                call(scene, 0.3, seed=seed, progress=False, cache=folder)


def test_factors_too_large_for_the_memory_are_refused(factors, box, tmp_path, monkeypatch):
    monkeypatch.setattr("radiosity.keep.available_bytes", lambda: 100_000)
    for method in METHODS:
        factors[method].save(tmp_path / f"{method}.npz")
        with pytest.raises(MemoryError, match=rf"{method}\.npz: these form factors need \d+ bytes"):
            rad.load_form_factors(tmp_path / f"{method}.npz", box)
    # What is mapped takes nothing, and in a convex room no pair is partly hidden.
    room = rad.scenes.furnace(0.5, 1.0, max_edge=0.2)
    rad.form_factors(room, 0.3, progress=False).save(tmp_path / "room.npz")
    assert rad.load_form_factors(tmp_path / "room.npz", room).nbytes > 100_000


def test_what_memory_has_ended_is_not_kept(box, tmp_path, monkeypatch):
    for name, call in (("form_factors", rad.form_factors), ("solve", rad.solve)):
        with monkeypatch.context() as patch:
            # A quarter of what the links of this scene take.
            patch.setattr(importlib.import_module(f"radiosity.{name}"), "available_bytes", lambda: 4_000_000)
            with pytest.warns(UserWarning, match="above the tolerance"):
                call(box, 0.05, "hierarchical", progress=False, cache=tmp_path)
        assert list(tmp_path.iterdir()) == []


def test_a_cache_that_is_none_is_refused(box, tmp_path):
    (tmp_path / "file").write_text("x", encoding="ascii")
    for call in (rad.form_factors, rad.solve):
        with pytest.raises(OSError, match="cache cannot be written to"):
            call(box, 0.3, progress=False, cache=tmp_path / "file")
        with pytest.raises(TypeError, match="cache must be None or the path of a folder, not bool"):
            call(box, 0.3, progress=False, cache=True)


def _cached(folder):
    box = rad.scenes.cornell_box(max_edge=0.25)
    F = rad.form_factors(box, 0.05, seed=3, progress=False, cache=folder)
    return F.toarray(), rad.solve(box, 0.3, progress=False, cache=folder).radiosity


def test_processes_share_a_cache(factors, box, tmp_path):
    radiosity = rad.solve(box, 0.3, progress=False).radiosity
    with multiprocessing.get_context("spawn").Pool(2) as pool:
        for array, found in pool.map(_cached, [tmp_path] * 4, chunksize=1):
            np.testing.assert_array_equal(array, factors["analytic"].toarray())
            np.testing.assert_array_equal(found, radiosity)
    assert len(list(tmp_path.iterdir())) == 2
