"""Damaged files and absurd arguments: whatever comes in, what comes out is a result or an error that a user can read.

    python tests/python/fuzz.py --seconds 1800 --seed 7

runs until the time is over and tells every case that went wrong; test_fuzz.py runs some hundred of the same cases.
"""

import argparse
import faulthandler
import io
import json
import struct
import sys
import tempfile
import time
import warnings
from pathlib import Path

import numpy as np

import radiosity as rad

CORPUS = Path(__file__).parents[1] / "data" / "corpus"
KINDS = ("glb", "gltf", "obj", "mtl", "ply", "stl", "npz")
# What a user is told with. ConvergenceError carries the unfinished solution, ImportError names the missing package.
REFUSALS = (ValueError, TypeError, OSError, MemoryError, rad.ConvergenceError)
MOST_SECONDS = 10.0
QUIET = {"progress": False}

_NUMBERS = [0, 1, -1, 2**31 - 1, -(2**31), 2**32 - 1, 2**63 - 1, 2**64, 1e-320, 1e30, 1e308, -1e308, 0.1, 10**400]
_ODD = [*_NUMBERS, None, True, "", "x", "nan", [], {}, [0], [[]], {"a": 1}, [1e308] * 3, "\u2028", "../../etc/passwd"]
_WORDS = [
    b"nan",
    b"inf",
    b"-inf",
    b"1e308",
    b"1e-320",
    b"-1",
    b"0",
    b"99999999999999999999",
    b"//",
    b"",
    b"\0",
    b"\xff\xfe",
]


def damaged(kind, data, rng):
    """The bytes of a file with a few things wrong."""
    if kind == "glb" and rng.random() < 0.6:
        return _damaged_glb(data, rng)
    if kind == "gltf" and rng.random() < 0.6:
        tree = json.loads(data)
        _damage_tree(tree, rng)
        return json.dumps(tree).encode()
    if kind == "npz" and rng.random() < 0.8:
        return _damaged_npz(data, rng)
    if kind in ("obj", "mtl", "gltf") or rng.random() < 0.3:
        data = _damaged_words(data, rng)
        if rng.random() < 0.5:
            return data
    return _damaged_bytes(data, rng)


def _damaged_bytes(data, rng):
    out = bytearray(data)
    for _ in range(rng.integers(1, 5)):
        at, size = int(rng.integers(0, len(out) + 1)), int(rng.integers(1, 9))
        match rng.integers(0, 6):
            case 0:
                out[at : at + 1] = bytes([rng.integers(0, 256)])
            case 1:
                del out[at : at + size]
            case 2:
                out[at:at] = rng.bytes(size)
            case 3:
                del out[at:]
            case 4:
                out[at:at] = out[at : at + 20 * size]
            case 5:
                out[at : at + 4] = struct.pack("<I", int(rng.choice([0, 1, 2**31, 2**32 - 1, len(data)])))
    return bytes(out)


def _damaged_words(data, rng):
    lines = data.split(b"\n")
    for _ in range(rng.integers(1, 4)):
        k = int(rng.integers(0, len(lines)))
        words = lines[k].split(b" ")
        j = int(rng.integers(0, len(words)))
        match rng.integers(0, 5):
            case 0:
                words[j] = _WORDS[rng.integers(0, len(_WORDS))]
            case 1:
                words.insert(j, words[int(rng.integers(0, len(words)))])
            case 2:
                del words[j]
            case 3:
                lines.insert(k, lines[int(rng.integers(0, len(lines)))])
            case 4:
                words[j] += _WORDS[rng.integers(0, len(_WORDS))]
        lines[k] = b" ".join(words)
    return b"\n".join(lines)


def _damage_tree(tree, rng):
    """Changes a few places of a JSON tree in place."""
    for _ in range(rng.integers(1, 4)):
        holders = []
        stack = [tree]
        while stack:
            holder = stack.pop()
            keys = list(holder) if isinstance(holder, dict) else range(len(holder))
            holders += [(holder, key) for key in keys]
            stack += [holder[key] for key in keys if isinstance(holder[key], (dict, list))]
        if not holders:
            return
        holder, key = holders[rng.integers(0, len(holders))]
        match rng.integers(0, 4):
            case 0:
                del holder[key]
            case 1:
                other, name = holders[rng.integers(0, len(holders))]
                # A copy: a tree that holds itself cannot be written.
                holder[key] = json.loads(json.dumps(other[name]))
            case _:
                holder[key] = _ODD[rng.integers(0, len(_ODD))]


def _damaged_glb(data, rng):
    (size,) = struct.unpack_from("<I", data, 12)
    tree = json.loads(data[20 : 20 + size])
    _damage_tree(tree, rng)
    text = json.dumps(tree).encode()
    text += b" " * (-len(text) % 4)
    rest = data[20 + size :]
    return struct.pack("<4sIII4s", b"glTF", 2, 20 + len(text) + len(rest), len(text), b"JSON") + text + rest


def _damaged_npz(data, rng):
    with np.load(io.BytesIO(data)) as file:
        arrays = {name: file[name] for name in file.files}
    for _ in range(rng.integers(1, 3)):
        name = str(rng.choice(list(arrays)))
        array = arrays[name]
        match rng.integers(0, 6):
            case 0:
                del arrays[name]
            case 1:
                arrays[name] = odd_array(array, rng)
            case 2:
                arrays[name] = arrays[str(rng.choice(list(arrays)))]
            case 3 if name.endswith("report"):
                tree = json.loads(str(array))
                _damage_tree(tree, rng)
                arrays[name] = np.array(json.dumps(tree))
            case _ if array.size and array.dtype.kind in "fi":
                array = array.copy()
                value = rng.choice([0, 1, -1, 2**31, 1e308 if array.dtype.kind == "f" else 2**62])
                with np.errstate(over="ignore"):  # in 32 bits 1e308 is infinite, as damaged as can be
                    array.flat[rng.integers(0, array.size)] = value
                arrays[name] = array
    out = io.BytesIO()
    # A pickled array must be refused, and never be loaded.
    np.savez(out, **arrays)
    return out.getvalue()


def odd_array(array, rng):
    """The same numbers as something that they should not be, or that is just unusual."""
    array = np.asarray(array)
    match rng.integers(0, 14):
        case 0:
            return array.astype(object)
        case 1:
            return array.astype(str)
        case 2:
            return array.reshape(-1)
        case 3:
            return array[None]
        case 4:
            return array[..., :-1] if array.ndim else array[()]
        case 5:
            return array[:0] if array.ndim else np.empty(0)
        case 6:
            return np.asfortranarray(array)
        case 7:
            return array.astype(array.dtype.newbyteorder()) if array.dtype.kind in "fiu" else array
        case 8:
            return np.repeat(array, 2, axis=-1)[..., ::2] if array.ndim else array
        case 9:
            with np.errstate(over="ignore"):
                return array.astype(np.float16) if array.dtype.kind in "fi" else array
        case 10:
            return np.broadcast_to(array, (2, *array.shape))
        case 11:
            return array.astype(np.complex128) if array.dtype.kind in "fi" else array
        case 12:
            return np.ma.masked_array(array, mask=False) if array.dtype.kind in "fi" else array
        case _:
            out = np.array(array)
            out.flags.writeable = False
            return out


def file_case(rng):
    """One damaged file, read."""
    paths = sorted(path for path in CORPUS.iterdir() if path.suffix[1:] in KINDS)
    path = paths[rng.integers(0, len(paths))]
    kind = path.suffix[1:]
    data = damaged(kind, path.read_bytes(), rng)
    with tempfile.TemporaryDirectory() as folder:
        name = Path(folder) / path.name
        name.write_bytes(data)
        if kind == "mtl":
            name = Path(folder) / "groups.obj"
            name.write_bytes((CORPUS / name.name).read_bytes())
        elif kind == "obj":
            (Path(folder) / "materials.mtl").write_bytes((CORPUS / "materials.mtl").read_bytes())
        if kind == "npz":
            solution = rad.load_solution(name)
            # What has been loaded can be used.
            str(solution.report)
            rad.save(solution, name)
            if solution.scene is not None:
                rad.save(solution, name.with_suffix(".ply"), exposure=1.0)
                rad.render(solution, rad.Camera((3, 3, 3), (0.5, 0.5, 0)), 4, 4, **QUIET)
        else:
            str(rad.load(name).report())


_FLOATS = [
    0.0,
    -0.0,
    5e-324,
    1e-310,
    1e-160,
    1e-17,
    1e160,
    1e308,
    -1e308,
    np.nan,
    np.inf,
    -np.inf,
    0.5,
    1.0,
    1.0 + 1e-15,
]


def _floats(rng, shape):
    out = rng.integers(-2, 3, shape).astype(float)
    for _ in range(rng.integers(0, 3)):
        if out.size:
            out.flat[rng.integers(0, out.size)] = _FLOATS[rng.integers(0, len(_FLOATS))]
    return odd_array(out, rng) if rng.random() < 0.2 else out


def array_case(rng):
    """Arrays of all sorts to everything that takes arrays."""
    v, n, b, m = (int(x) for x in rng.integers(0, 8, 4))
    faces = rng.integers(0, max(v, 1), (n, 3))
    if n and rng.random() < 0.1:
        faces[0, 0] = rng.choice([-1, 2**31, 2**62, v])
    if rng.random() < 0.2:
        faces = odd_array(faces, rng)
    match rng.integers(0, 7):
        case 0 | 1 | 2:
            materials = {
                "reflectance": np.abs(_floats(rng, (n, b))) / 4 if rng.random() < 0.5 else 0.5,
                "emission": np.abs(_floats(rng, (n, b))) if rng.random() < 0.5 else 1.0,
                "sides": ["front", "both"][rng.integers(0, 2)],
            }
            if rng.random() < 0.2:
                materials |= {
                    "mirror": _floats(rng, (n,)),
                    "ior": _floats(rng, (n,)),
                    "reflectance": 0.0,
                    "emission": 0.0,
                }
            scene = rad.Scene(_floats(rng, (v, 3)), faces, **materials)
            str(scene.report())
            scene.intersect(_floats(rng, (m, 3)), _floats(rng, (m, 3)))
            scene.occluded(_floats(rng, (m, 3)), _floats(rng, (m, 3)))
            rad.form_factors(scene, 0.1, **QUIET)
            solution = rad.solve(scene, 0.5, **QUIET)
            rad.render(solution, rad.Camera(tuple(_floats(rng, 3)), tuple(_floats(rng, 3))), 4, 4, **QUIET)
        case 3:
            rad.form_factor(_floats(rng, (n, 3)), _floats(rng, (m, 3)))
        case 4:
            rad.pair_form_factors(_floats(rng, (n, 3, 3)), _floats(rng, (n, 3, 3)), **QUIET)
        case 5:
            matrix = np.abs(_floats(rng, (n, n))) / max(2 * n, 1)
            method = ["direct", "jacobi", "gauss_seidel", "southwell", "overshooting", "gmres"][rng.integers(0, 6)]
            rad.solve_system(matrix, _floats(rng, (n, b)), np.abs(_floats(rng, (n, b))) / 4, method, **QUIET)
        case 6:
            rad.ambient(_floats(rng, n), _floats(rng, (n, b)), _floats(rng, (n, b)))


_VALUES = [
    *(None, True, -1, 0, 1, 2, 3, 2**31, 2**63, 2**64, 10**30, 0.5, -0.5, 1e-12, 1e308, np.nan, np.inf, "x", b"x"),
    *("", [], (), {}, [1], [1, 2, 3], object(), np.float32(0.5), np.int8(3), np.array([1]), np.array(0.5), 1j, len),
]


def argument_case(rng):
    """A call that is sound but for one argument or two."""
    room = rad.scenes.furnace(0.5, 1.0)
    camera = {"origin": (0.5, 0.5, 0.9), "target": (0.5, 0.6, 0.0)}
    calls = [
        (
            rad.solve,
            {"scene": room, "tolerance": 0.3, "method": "auto", "order": 1, "refine": True, "seed": 0, "threads": 1},
        ),
        (rad.form_factors, {"scene": room, "tolerance": 0.2, "method": "auto", "seed": 0, "threads": 1}),
        (rad.forecast, {"scene": room, "tolerance": 0.3, "order": 1, "refine": True, "seed": 0, "threads": 1}),
        (rad.virtual_lights, {"scene": room, "count": 16, "seed": 0, "threads": 1}),
        (
            rad.instant,
            {"scene": room, "camera": rad.Camera(**camera), "width": 4, "height": 4, "lights": 16, "shadows": "rays"}
            | {"bound": None, "compensate": True, "seed": 0, "threads": 1},
        ),
        (
            rad.render,
            {"solution": None, "camera": rad.Camera(**camera), "width": 4, "height": 4, "shading": "smooth"}
            | {"tolerance": 0.2, "seed": 0, "threads": 1},
        ),
        (
            rad.solve_system,
            {"F": np.full((2, 2), 0.4), "emission": 1.0, "reflectance": 0.5, "method": "jacobi", "tolerance": 1e-3}
            | {"max_iterations": None, "threads": 1},
        ),
        (rad.Camera, {**camera, "up": (0, 0, 1), "fov": 40.0}),
        (room.subdivide, {"max_edge": 0.5}),
        (room.intersect, {"origins": [[0.5] * 3], "directions": [[1, 0, 0]], "threads": 1}),
        (rad.load, {"path": "nowhere.glb"}),
        (rad.load_solution, {"path": "nowhere.npz"}),
    ]
    function, arguments = calls[rng.integers(0, len(calls))]
    if "solution" in arguments:
        arguments["solution"] = rad.solve(room, 0.3, **QUIET)
    for _ in range(rng.integers(1, 3)):
        value = _VALUES[rng.integers(0, len(_VALUES))]
        name = str(rng.choice(list(arguments)))
        if name == "tolerance" and isinstance(value, float) and 0.0 < value < 0.1:
            # Allowed, and honest work of hours.
            continue
        arguments[name] = value
    quiet = QUIET if function in (rad.solve, rad.form_factors, rad.forecast, rad.instant, rad.render) else {}
    result = function(**arguments, **quiet)
    if function is rad.Camera:
        rad.render(rad.solve(room, 0.3, **QUIET), result, 4, 4, **QUIET)


CASES = {"file": file_case, "array": array_case, "argument": argument_case}


def outcome(name, seed):
    """What went wrong in a case, None where nothing did."""
    start = time.perf_counter()
    with warnings.catch_warnings(record=True) as seen:
        warnings.simplefilter("always")
        try:
            CASES[name](np.random.default_rng([seed, list(CASES).index(name)]))
        except REFUSALS as error:
            # numpy's own way to say that memory is short derives from MemoryError; others carry no message at all.
            wrong = None if str(error) else f"{type(error).__name__} without a reason"
        except BaseException as error:
            wrong = f"{type(error).__module__}.{type(error).__name__}: {error}"
        else:
            wrong = None
    seconds = time.perf_counter() - start
    if wrong is None and seconds > MOST_SECONDS:
        wrong = f"took {seconds:.1f} s"
    internal = [f"{w.category.__name__}: {w.message}" for w in seen if w.category is not UserWarning]
    return wrong or (f"warned of {internal[0]}" if internal else None)


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seconds", type=float, default=60.0)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--only", choices=CASES)
    options = parser.parse_args()
    counts, wrong = dict.fromkeys([options.only] if options.only else CASES, 0), 0
    seed, end = options.seed << 32, time.process_time() + options.seconds
    while time.process_time() < end:
        for name in counts:
            # A hang has no end of its own: it is told with the place where it hangs.
            faulthandler.dump_traceback_later(12 * MOST_SECONDS, exit=True)
            what = outcome(name, seed)
            counts[name] += 1
            if what:
                wrong += 1
                print(f"{name} {seed}: {what}", flush=True)
        seed += 1
    faulthandler.cancel_dump_traceback_later()
    print(f"{counts} cases in {options.seconds:g} s of the processor, {wrong} went wrong")
    return 1 if wrong else 0


if __name__ == "__main__":
    sys.exit(main())
