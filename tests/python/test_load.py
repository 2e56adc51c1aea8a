"""Files and trimesh meshes become scenes: every corner, colour and name is found again where the file has it."""

import json
import math
import struct
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh
from PIL import Image

import radiosity as rad
from radiosity.load import from_trimesh
from radiosity.materials import srgb_to_linear, texture_means

DATA = Path(rad.__file__).parent / "data"
REFERENCE = Path(__file__).parents[1] / "data" / "scenes" / "cornell_1004.npz"

# glTF and binary STL and PLY store positions in 32 bits.
SINGLE = float(np.finfo(np.float32).eps)

TRIANGLE = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])


class Gltf:
    """A glTF document under construction, written by hand: the files must not depend on the library that reads them."""

    def __init__(self) -> None:
        self.tree: dict[str, Any] = {
            "asset": {"version": "2.0"},
            "scene": 0,
            "scenes": [{"nodes": []}],
            "nodes": [],
            "meshes": [],
            "materials": [],
            "accessors": [],
            "bufferViews": [],
        }
        self.blob = b""

    def add(self, key: str, **item: Any) -> int:
        self.tree.setdefault(key, []).append(item)
        return len(self.tree[key]) - 1

    def root(self, **node: Any) -> int:
        self.tree["scenes"][0]["nodes"].append(self.add("nodes", **node))
        return self.tree["scenes"][0]["nodes"][-1]

    def accessor(self, array: np.ndarray, kind: str, component: int, **more: Any) -> int:
        view = self.add("bufferViews", buffer=0, byteOffset=len(self.blob), byteLength=array.nbytes)
        self.blob += array.tobytes() + bytes(-array.nbytes % 4)
        return self.add("accessors", bufferView=view, componentType=component, count=len(array), type=kind, **more)

    def primitive(self, corners: np.ndarray, faces: Any = ((0, 1, 2),), **more: Any) -> dict[str, Any]:
        position = self.accessor(np.asarray(corners, dtype="<f4"), "VEC3", 5126)
        indices = self.accessor(np.asarray(faces, dtype="<u2").reshape(-1), "SCALAR", 5123)
        attributes = {"POSITION": position, **more.pop("attributes", {})}
        return {"attributes": attributes, "indices": indices, **more}

    def write(self, path: Path) -> Path:
        tree = {key: value for key, value in self.tree.items() if value != []}
        if path.suffix == ".gltf":
            tree["buffers"] = [{"byteLength": len(self.blob), "uri": "mesh.bin"}]
            (path.parent / "mesh.bin").write_bytes(self.blob)
            path.write_text(json.dumps(tree))
            return path
        tree["buffers"] = [{"byteLength": len(self.blob)}]
        text = json.dumps(tree).encode()
        text += b" " * (-len(text) % 4)
        body = (
            struct.pack("<I4s", len(text), b"JSON") + text + struct.pack("<I4s", len(self.blob), b"BIN\0") + self.blob
        )
        path.write_bytes(struct.pack("<4sII", b"glTF", 2, 12 + len(body)) + body)
        return path


@pytest.fixture
def gltf() -> Gltf:
    return Gltf()


def corners(scene: rad.Scene) -> np.ndarray:
    return scene.vertices[scene.faces]


# -------------------------------------------------------------------------------------------------------------- glTF


@pytest.mark.parametrize("extension", ["glb", "gltf"])
def test_gltf_keeps_factors_strength_names_and_order(tmp_path: Path, gltf: Gltf, extension: str) -> None:
    # 1/3 and 0.1 are no multiples of 1/255: rounding to 8 bits, as trimesh does, would show.
    lamp = gltf.add(
        "materials",
        name="same",
        pbrMetallicRoughness={"baseColorFactor": [1 / 3, 0.1, 0.7, 1.0]},
        emissiveFactor=[1.0, 0.5, 0.25],
        extensions={"KHR_materials_emissive_strength": {"emissiveStrength": 17.5}},
    )
    wall = gltf.add("materials", name="same", pbrMetallicRoughness={"baseColorFactor": [0.9, 0.8, 0.1, 1.0]})
    quad = np.array([[0, 0, 1], [1, 0, 1], [1, 1, 1], [0, 1, 1]])
    first = gltf.add("meshes", primitives=[gltf.primitive(quad, [[0, 1, 2], [0, 2, 3]], material=lamp)])
    second = gltf.add(
        "meshes",
        name="panel",
        primitives=[gltf.primitive(TRIANGLE, material=wall), gltf.primitive(TRIANGLE + 2, material=lamp)],
    )
    gltf.root(name="lamp", mesh=first)
    gltf.root(name="wall", mesh=second)
    gltf.root(mesh=second, translation=[0, 0, 5])

    scene = rad.load(gltf.write(tmp_path / f"room.{extension}"))

    assert scene.names == ("lamp", "lamp", "wall", "wall", "panel", "panel")
    shift = np.array([0, 0, 5])
    expected = [quad[[0, 1, 2]], quad[[0, 2, 3]], TRIANGLE, TRIANGLE + 2, TRIANGLE + shift, TRIANGLE + 2 + shift]
    np.testing.assert_array_equal(corners(scene), expected)  # small integers are exact in 32 bits
    lamp_rows, wall_rows = [0, 1, 3, 5], [2, 4]
    # The JSON holds doubles, so nothing is rounded but the products.
    np.testing.assert_allclose(scene.reflectance[lamp_rows], [[1 / 3, 0.1, 0.7]] * 4, rtol=1e-15)
    np.testing.assert_allclose(scene.reflectance[wall_rows], [[0.9, 0.8, 0.1]] * 2, rtol=1e-15)
    np.testing.assert_allclose(scene.emission[lamp_rows], math.pi * 17.5 * np.array([[1, 0.5, 0.25]] * 4), rtol=1e-15)
    assert not scene.emission[wall_rows].any()


def test_gltf_default_material_is_grey_and_stated_white_stays_white(tmp_path: Path, gltf: Gltf) -> None:
    unstated = gltf.add("materials", name="metal", pbrMetallicRoughness={"metallicFactor": 0.0})
    white = gltf.add("materials", pbrMetallicRoughness={"baseColorFactor": [1.0, 1.0, 1.0, 1.0]})
    dim = gltf.add("materials", emissiveFactor=[0.5, 0.5, 0.5])
    parts = [
        gltf.primitive(TRIANGLE + k, **more) for k, more in enumerate([{"material": unstated}, {"material": white}])
    ]
    parts += [gltf.primitive(TRIANGLE + 5), gltf.primitive(TRIANGLE + 7, material=dim)]
    gltf.root(mesh=gltf.add("meshes", primitives=parts))
    scene = rad.load(gltf.write(tmp_path / "a.glb"))
    np.testing.assert_array_equal(scene.reflectance[:, 0], [0.5, 1.0, 0.5, 0.5])
    # Without the extension the strength is 1.
    np.testing.assert_allclose(scene.emission[:, 2], [0, 0, 0, 0.5 * math.pi], rtol=1e-15)


def test_gltf_transforms_nest_and_mirrors_keep_the_front(tmp_path: Path, gltf: Gltf) -> None:
    mesh = gltf.add("meshes", primitives=[gltf.primitive(TRIANGLE)])
    turned = gltf.add("nodes", name="turned", mesh=mesh, rotation=[0, 0, math.sqrt(0.5), math.sqrt(0.5)])
    mirrored = gltf.add("nodes", name="mirrored", mesh=mesh, scale=[-1, 1, 1])
    columns = np.eye(4)
    columns[3, :3] = [10, 20, 30]  # glTF writes matrices column by column: this is the last column
    gltf.root(name="group", matrix=columns.reshape(-1).tolist(), children=[turned, mirrored])
    scene = rad.load(gltf.write(tmp_path / "a.glb"))
    assert scene.names == ("turned", "mirrored")
    shift = np.array([10, 20, 30])
    quarter_turn = np.array([[0, -1, 0], [1, 0, 0], [0, 0, 1]])
    # The rotation is rounded to 64 bits; coordinates reach 30.
    np.testing.assert_allclose(corners(scene)[0], TRIANGLE @ quarter_turn.T + shift, atol=30 * 1e-15)
    np.testing.assert_allclose(scene.normals, [[0, 0, 1], [0, 0, 1]], atol=1e-14)
    np.testing.assert_allclose(sorted(corners(scene)[1][:, 0]), [9, 10, 10], atol=30 * 1e-15)


def test_gltf_strips_and_meshes_without_indices(tmp_path: Path, gltf: Gltf) -> None:
    strip = gltf.primitive(np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 0]]), [0, 1, 2, 3], mode=5)
    plain = gltf.primitive(np.vstack([TRIANGLE, TRIANGLE + 1]))
    del plain["indices"]
    gltf.root(name="both", mesh=gltf.add("meshes", primitives=[strip, plain]))
    scene = rad.load(gltf.write(tmp_path / "a.glb"))
    assert scene.n_patches == 4
    np.testing.assert_array_equal(scene.normals, [[0, 0, 1]] * 4)


def test_gltf_vertex_colours_are_linear_and_multiply_the_base_colour(tmp_path: Path, gltf: Gltf) -> None:
    colours = np.array([[0.3, 0.0, 0.9], [0.6, 0.0, 0.9], [0.0, 0.3, 0.9]], dtype="<f4")
    colour = gltf.accessor(colours, "VEC3", 5126)
    half = gltf.add("materials", pbrMetallicRoughness={"baseColorFactor": [0.5, 1.0, 0.1, 1.0]})
    with_material = gltf.primitive(TRIANGLE, attributes={"COLOR_0": colour}, material=half)
    without = gltf.primitive(TRIANGLE + 1, attributes={"COLOR_0": colour})
    gltf.root(mesh=gltf.add("meshes", primitives=[with_material, without]))
    scene = rad.load(gltf.write(tmp_path / "a.glb"))
    np.testing.assert_allclose(scene.reflectance[0], [0.15, 0.1, 0.09], rtol=4 * SINGLE)
    # Without a material trimesh keeps the colours in 8 bits: half a step of 1/255.
    np.testing.assert_allclose(scene.reflectance[1], [0.3, 0.1, 0.9], atol=0.5 / 255 + 1e-12)


def test_gltf_textures_are_averaged_over_the_patch(tmp_path: Path, gltf: Gltf) -> None:
    image = np.zeros((64, 64, 3), dtype=np.uint8)
    image[:, :32] = [255, 128, 0]  # left half
    image[:, 32:] = [0, 128, 255]
    Image.fromarray(image).save(tmp_path / "halves.png")
    gltf.add("images", uri="halves.png")
    gltf.add("textures", source=0)
    material = gltf.add(
        "materials",
        pbrMetallicRoughness={"baseColorFactor": [0.5, 0.5, 0.5, 1], "baseColorTexture": {"index": 0}},
        emissiveFactor=[1, 1, 1],
        emissiveTexture={"index": 0},
    )
    uv = gltf.accessor(np.array([[0.02, 0.1], [0.48, 0.1], [0.02, 0.9]], dtype="<f4"), "VEC2", 5126)
    left = gltf.primitive(TRIANGLE, attributes={"TEXCOORD_0": uv}, material=material)
    gltf.root(mesh=gltf.add("meshes", primitives=[left]))
    scene = rad.load(gltf.write(tmp_path / "a.glb"))
    green = float(srgb_to_linear(128 / 255))
    # The triangle stays within one colour, also at the coarser level that is sampled: no error but rounding.
    np.testing.assert_allclose(scene.reflectance[0], [0.5, 0.5 * green, 0.0], atol=1e-12)
    np.testing.assert_allclose(scene.emission[0], [math.pi, math.pi * green, 0.0], atol=1e-12)


CLEAR = {"KHR_materials_transmission": {"transmissionFactor": 1.0}}
IOR = {"KHR_materials_ior": {"ior": 1.33}}
PLASTIC = {"metallicFactor": 0.0, "roughnessFactor": 0.0}
TINT = {"baseColorFactor": [0.9, 1.0, 0.9, 1.0]}


@pytest.mark.parametrize(
    ("stated", "more", "mirror", "ior"),
    [
        # Metal is what a material is that does not say otherwise.
        ({"roughnessFactor": 0.0}, {}, 1.0, math.nan),
        ({"metallicFactor": 1.0, "roughnessFactor": 0.1, "baseColorFactor": [0.3, 0.3, 0.3, 1.0]}, {}, 0.3, math.nan),
        ({"metallicFactor": 1.0}, {}, 0.0, math.nan),
        (PLASTIC, {}, 0.0, math.nan),
        (PLASTIC, {"extensions": CLEAR}, 0.0, 1.5),
        ({**PLASTIC, "baseColorFactor": [1.0, 1.0, 1.0, 1.0]}, {"extensions": {**CLEAR, **IOR}}, 0.0, 1.33),
        (PLASTIC, {"extensions": IOR}, 0.0, math.nan),
        # Metal lets nothing through.
        ({"roughnessFactor": 0.0}, {"extensions": CLEAR}, 1.0, math.nan),
    ],
)
@pytest.mark.filterwarnings("error::UserWarning")
def test_gltf_polished_metal_is_a_mirror_and_what_is_clear_is_glass(
    tmp_path: Path, gltf: Gltf, stated: dict[str, Any], more: dict[str, Any], mirror: float, ior: float
) -> None:
    finished = gltf.add("materials", pbrMetallicRoughness=stated, **more)
    wall = gltf.add("materials", pbrMetallicRoughness={"baseColorFactor": [0.2, 0.4, 0.6, 1.0]})
    parts = [gltf.primitive(TRIANGLE, material=finished), gltf.primitive(TRIANGLE + 2, material=wall)]
    gltf.root(mesh=gltf.add("meshes", primitives=parts))
    scene = rad.load(gltf.write(tmp_path / "a.glb"))
    np.testing.assert_array_equal(scene.mirror, [mirror, 0.0])
    np.testing.assert_array_equal(scene.ior, [ior, math.nan])
    is_diffuse = mirror == 0.0 and math.isnan(ior)
    np.testing.assert_array_equal(scene.reflectance, [[0.5 if is_diffuse else 0.0] * 3, [0.2, 0.4, 0.6]])


@pytest.mark.parametrize(
    ("stated", "more", "told"),
    [
        ({"roughnessFactor": 0.3}, {}, r"'it' is no mirror \(metalness 1, roughness 0.3\): it is read as diffuse"),
        ({"metallicFactor": 0.5, "roughnessFactor": 0.0}, {}, "is no mirror .metalness 0.5"),
        ({"roughnessFactor": 0.0, "metallicRoughnessTexture": {"index": 0}}, {}, "roughness 0 times a texture"),
        ({"roughnessFactor": 0.0}, {"emissiveFactor": [1, 1, 1]}, "is no mirror .*, emission"),
        (
            {"metallicFactor": 0.0},
            {"extensions": CLEAR},
            r"is no clear glass \(transmission 1, metalness 0, roughness 1\)",
        ),
        (PLASTIC, {"extensions": {"KHR_materials_transmission": {"transmissionFactor": 0.5}}}, "transmission 0.5"),
        (PLASTIC, {"extensions": CLEAR, "emissiveFactor": [1, 1, 1]}, "is no clear glass .*, emission"),
    ],
)
def test_gltf_gloss_and_frost_are_diffuse_and_said_to_be(
    tmp_path: Path, gltf: Gltf, stated: dict[str, Any], more: dict[str, Any], told: str
) -> None:
    base = {"baseColorFactor": [0.2, 0.4, 1.0, 1.0]}
    material = gltf.add("materials", name="it", pbrMetallicRoughness={**base, **stated}, **more)
    gltf.root(mesh=gltf.add("meshes", primitives=[gltf.primitive(TRIANGLE + k, material=material) for k in (0, 2)]))
    with pytest.warns(UserWarning, match=rf"a\.glb: material .*{told}") as warned:
        scene = rad.load(gltf.write(tmp_path / "a.glb"))
    assert len(warned) == 1
    assert scene.is_diffuse
    np.testing.assert_array_equal(scene.reflectance, [base["baseColorFactor"][:3]] * 2)


def test_gltf_coloured_mirrors_are_grey_and_tinted_glass_clear(tmp_path: Path, gltf: Gltf) -> None:
    gold = gltf.add(
        "materials", name="gold", pbrMetallicRoughness={"roughnessFactor": 0.0, "baseColorFactor": [1.0, 0.8, 0.3, 1]}
    )
    bottle = gltf.add("materials", name="bottle", pbrMetallicRoughness={**PLASTIC, **TINT}, extensions=CLEAR)
    parts = [gltf.primitive(TRIANGLE, material=gold), gltf.primitive(TRIANGLE + 2, material=bottle)]
    gltf.root(mesh=gltf.add("meshes", primitives=parts))
    with pytest.warns(UserWarning, match="a.glb: material") as warned:
        scene = rad.load(gltf.write(tmp_path / "a.glb"))
    told = [str(warning.message) for warning in warned]
    assert len(told) == 2
    assert "material 'gold' is a mirror of colour" in told[0]
    assert "material 'bottle' is tinted glass" in told[1]
    # ITU-R BT.709.
    np.testing.assert_allclose(scene.mirror, [0.2126 + 0.8 * 0.7152 + 0.3 * 0.0722, 0.0], rtol=1e-15)
    np.testing.assert_array_equal(scene.ior, [math.nan, 1.5])
    assert not scene.reflectance.any()


def test_gltf_warns_about_what_bears_on_light_and_is_left_out(tmp_path: Path, gltf: Gltf) -> None:
    gltf.tree["extensionsUsed"] = ["KHR_lights_punctual"]
    gltf.root(mesh=gltf.add("meshes", primitives=[gltf.primitive(TRIANGLE)]))
    with pytest.warns(UserWarning, match=r"lamps\.glb: point, spot and directional lights are left out"):
        rad.load(gltf.write(tmp_path / "lamps.glb"))


def test_gltf_missing_image_is_said(tmp_path: Path, gltf: Gltf) -> None:
    gltf.add("images", uri="nowhere.png")
    gltf.add("textures", source=0)
    material = gltf.add("materials", name="wood", pbrMetallicRoughness={"baseColorTexture": {"index": 0}})
    uv = gltf.accessor(np.zeros((3, 2), dtype="<f4"), "VEC2", 5126)
    primitive = gltf.primitive(TRIANGLE, attributes={"TEXCOORD_0": uv}, material=material)
    gltf.root(mesh=gltf.add("meshes", primitives=[primitive]))
    with pytest.warns(UserWarning, match=r"baseColorTexture of material 'wood' could not be read"):
        scene = rad.load(gltf.write(tmp_path / "a.glb"))
    assert scene.reflectance[0, 0] == 0.5
    del primitive["attributes"]["TEXCOORD_0"]
    with pytest.warns(UserWarning, match=r"baseColorTexture of material 'wood' has no texture coordinates"):
        rad.load(gltf.write(tmp_path / "a.glb"))


def bad_mode(gltf: Gltf) -> None:
    gltf.tree["meshes"][0]["primitives"][0]["mode"] = 1


def bad_fan(gltf: Gltf) -> None:
    gltf.tree["meshes"][0]["primitives"][0]["mode"] = 6


def needs_draco(gltf: Gltf) -> None:
    gltf.tree["extensionsRequired"] = ["KHR_draco_mesh_compression"]


def sparse(gltf: Gltf) -> None:
    gltf.tree["accessors"][0]["sparse"] = {"count": 1}


def cycle(gltf: Gltf) -> None:
    gltf.tree["nodes"][0]["children"] = [0]


def no_nodes(gltf: Gltf) -> None:
    gltf.tree["scenes"][0]["nodes"] = []


def missing_material(gltf: Gltf) -> None:
    gltf.tree["meshes"][0]["primitives"][0]["material"] = 3


def not_finite(gltf: Gltf) -> None:
    gltf.blob = struct.pack("<f", math.nan) + gltf.blob[4:]


@pytest.mark.parametrize(
    ("spoil", "reason"),
    [
        (bad_mode, "primitive 0 of mesh 'part' is lines; only triangles are supported"),
        (bad_fan, "is a triangle fan; only triangles"),
        (needs_draco, "requires KHR_draco_mesh_compression, which is not supported"),
        (sparse, "sparse accessors"),
        (cycle, "node 0 is reached twice"),
        (no_nodes, "the mesh is empty: it holds no triangles"),
        (missing_material, "not a valid GLB mesh"),
        (not_finite, "finite"),
    ],
)
def test_gltf_errors_name_the_file_and_the_reason(
    tmp_path: Path, gltf: Gltf, spoil: Callable[[Gltf], None], reason: str
) -> None:
    gltf.root(mesh=gltf.add("meshes", name="part", primitives=[gltf.primitive(TRIANGLE)]))
    spoil(gltf)
    with pytest.raises(ValueError, match=rf"bad\.glb: .*{reason}"):
        rad.load(gltf.write(tmp_path / "bad.glb"))


@pytest.mark.parametrize("kept", [3, 19, 60, -1])
def test_a_glb_cut_short_is_refused(tmp_path: Path, kept: int) -> None:
    path = tmp_path / "cut.glb"
    path.write_bytes((DATA / "cornell_box.glb").read_bytes()[:kept])
    with pytest.raises(ValueError, match=r"cut\.glb: (the file is cut short|not a GLB file)"):
        rad.load(path)


def test_a_gltf_without_its_buffer_is_refused(tmp_path: Path, gltf: Gltf) -> None:
    gltf.root(mesh=gltf.add("meshes", primitives=[gltf.primitive(TRIANGLE)]))
    path = gltf.write(tmp_path / "a.gltf")
    (tmp_path / "mesh.bin").unlink()
    with pytest.raises(ValueError, match=r"a\.gltf: not a valid GLTF mesh: .*mesh\.bin"):
        rad.load(path)


def test_trimesh_export_comes_back(tmp_path: Path) -> None:
    red = trimesh.visual.material.PBRMaterial(name="red", baseColorFactor=[204, 51, 0, 255], emissiveFactor=[0.5, 0, 0])
    box = trimesh.creation.box((1, 2, 3))
    box.visual = trimesh.visual.TextureVisuals(material=red)
    world = trimesh.Scene()
    world.add_geometry(box, node_name="crate", transform=trimesh.transformations.translation_matrix([1, 0, 0]))
    world.export(tmp_path / "world.glb")
    scene = rad.load(tmp_path / "world.glb")
    assert set(scene.names) == {"crate"}
    np.testing.assert_allclose(corners(scene), box.triangles + np.array([1, 0, 0]), atol=2 * SINGLE)
    np.testing.assert_allclose(scene.reflectance, [[0.8, 0.2, 0.0]] * 12, atol=1e-12)  # multiples of 1/255
    np.testing.assert_allclose(scene.emission[:, 0], 0.5 * math.pi, rtol=1e-12)


def test_the_shipped_cornell_box_is_the_reference_scene() -> None:
    scene = rad.load(DATA / "cornell_box.glb")
    with np.load(DATA / "cornell_box_reference.npz") as file, np.load(REFERENCE) as whole:
        # Rounding a coordinate below 1 to 32 bits moves it by half a unit in the last place at most.
        np.testing.assert_allclose(corners(scene), whole["vertices"][whole["faces"]], rtol=0, atol=SINGLE / 4)
        np.testing.assert_array_equal(scene.reflectance, whole["reflectance"])
        np.testing.assert_allclose(scene.emission, whole["emission"], rtol=1e-15)  # divided and multiplied by pi
        for name in ("radiosity", "stderr", "mitsuba_version", "paths"):
            np.testing.assert_array_equal(file[name], whole[name])


def test_the_shipped_cornell_box_is_the_built_in_one() -> None:
    scene = rad.load(DATA / "cornell_box.glb")
    with np.load(DATA / "cornell_box_reference.npz") as file:
        reference = dict(file)
    built_in = rad.scenes.cornell_box()
    for name in set(built_in.names):
        ours, theirs = np.array(scene.names) == name, np.array(built_in.names) == name
        # The red wall is a twisted quadrilateral: two triangles here, many there, areas 6e-6 apart.
        assert scene.areas[ours].sum() == pytest.approx(built_in.areas[theirs].sum(), rel=1e-5)
        np.testing.assert_allclose(
            np.unique(scene.reflectance[ours]), np.unique(built_in.reflectance[theirs]), atol=1e-6
        )
        np.testing.assert_allclose(np.unique(scene.emission[ours]), np.unique(built_in.emission[theirs]), atol=1e-6)
    # What a patch reflects is non-negative, nothing but noise beneath the blocks, and at most its reflectance times the
    # largest radiosity around: the irradiance is a mean of radiosities. 5 standard errors: 3,012 values, one chance in
    # 1,000 that noise alone goes that far.
    reflected, noise = reference["radiosity"] - scene.emission, 5 * reference["stderr"]
    assert np.all(reflected >= -noise)
    assert np.all(reflected <= scene.reflectance * reference["radiosity"].max(axis=0) + noise)
    assert list(dict.fromkeys(scene.names)) == list(dict.fromkeys(built_in.names))


# --------------------------------------------------------------------------------------------------------------- OBJ


def write_obj(folder: Path, text: str, materials: str = "") -> Path:
    if materials:
        (folder / "colours.mtl").write_text(materials)
    (folder / "room.obj").write_text(text)
    return folder / "room.obj"


ROOM = """mtllib colours.mtl
v 0 0 0
v 1 0 0
v 1 1 0
v 0 1 0
v 0 0 1
o ceiling_lamp
usemtl bright
f 1 2 3
o wall
usemtl dark
f 1 3 4
f 3 1 5
usemtl bright
f 2 3 5
"""
COLOURS = """newmtl dark
Kd 0.123 0.2 0.3
newmtl bright
Kd 0.78 0.78 0.78
Ke 17 12 4
"""


def test_obj_and_mtl_keep_objects_colours_and_order(tmp_path: Path) -> None:
    scene = rad.load(write_obj(tmp_path, ROOM, COLOURS))
    assert scene.names == ("ceiling_lamp", "wall", "wall", "wall")
    np.testing.assert_array_equal(corners(scene)[0], [[0, 0, 0], [1, 0, 0], [1, 1, 0]])
    np.testing.assert_array_equal(corners(scene)[1], [[0, 0, 0], [1, 1, 0], [0, 1, 0]])
    np.testing.assert_array_equal(corners(scene)[2], [[1, 1, 0], [0, 0, 0], [0, 0, 1]])
    np.testing.assert_array_equal(scene.reflectance[:, 0], [0.78, 0.123, 0.123, 0.78])
    np.testing.assert_allclose(scene.emission[[0, 3]], math.pi * np.array([[17, 12, 4]] * 2), rtol=1e-15)
    assert not scene.emission[1:3].any()


def test_obj_groups_and_materials_name_objects_too(tmp_path: Path) -> None:
    by_group = write_obj(tmp_path, "v 0 0 0\nv 1 0 0\nv 0 1 0\ng floor\nf 1 2 3\ng back\nf 3 2 1\n")
    assert rad.load(by_group).names == ("floor", "back")
    by_material = ROOM.replace("o ceiling_lamp\n", "").replace("o wall\n", "")
    assert rad.load(write_obj(tmp_path, by_material, COLOURS)).names == ("bright", "bright", "dark", "dark")
    nothing = write_obj(tmp_path, "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n")
    scene = rad.load(nothing)
    assert scene.names == ("room",)
    # No colour anywhere: one band, the default.
    np.testing.assert_array_equal(scene.reflectance, [[0.5]])
    np.testing.assert_array_equal(scene.emission, [[0.0]])


def test_obj_polygons_textures_and_normals_lose_no_area(tmp_path: Path) -> None:
    text = "v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nv -1 .5 0\nvt 0 0\nvt 1 0\nvt 1 1\nvn 0 0 1\n"
    scene = rad.load(write_obj(tmp_path, text + "f 1/1/1 2/2/1 3/3/1 4/1/1\nf 1//1 4//1 5//1\nf 1 2 3 4 5\n"))
    assert scene.n_patches == 2 + 1 + 3
    assert scene.areas.sum() == pytest.approx(1 + 0.5 + 1.5)
    np.testing.assert_array_equal(scene.normals[:2], [[0, 0, 1]] * 2)


def test_obj_says_which_materials_are_missing(tmp_path: Path) -> None:
    with pytest.warns(UserWarning, match=r"room\.obj: material file 'colours\.mtl' is missing"):
        scene = rad.load(write_obj(tmp_path, ROOM))
    assert set(scene.reflectance.ravel()) == {0.5}
    with pytest.warns(UserWarning, match=r"materials dark are not defined"):
        rad.load(write_obj(tmp_path, ROOM, "newmtl bright\nKd .1 .2 .3\n"))
    with pytest.warns(UserWarning, match=r"the image of material 'bright' could not be read"):
        rad.load(write_obj(tmp_path, ROOM, COLOURS + "map_Kd nowhere.png\n"))


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("", "the file is empty"),
        ("v 0 0 0\nv 1 0 0\nv 0 1 0\n", "no triangles|points and lines"),
        ("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\nl 1 2\n", "line 5 holds a 'l' element"),
        ("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 9\n", "9|index"),
        ("v 0 0 0\nv 1 0 0\nv 0 one 0\nf 1 2 3\n", "not a valid OBJ mesh"),
        ("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\nf 1 x 3\nf 2 3 1\n", "not a valid OBJ mesh"),
        ("v 0 0 0\nv 1 0 0\nv 0 1 0\nf -3 -2 -1\nv 5 5 5\nv 6 5 5\nv 5 6 5\nf -3 -2 -1\n", "negative vertex indices"),
        ("v 0 0 0\nv 1 0 0\nv 2 0 0\nf 1 2 3\n", "patch 0"),
    ],
)
def test_obj_errors_name_the_file_and_the_reason(tmp_path: Path, text: str, reason: str) -> None:
    with pytest.raises(ValueError, match=rf"room\.obj: .*({reason})"):
        rad.load(write_obj(tmp_path, text))


def test_obj_negative_indices_after_all_vertices(tmp_path: Path) -> None:
    scene = rad.load(write_obj(tmp_path, "v 9 9 9\nv 0 0 0\nv 1 0 0\nv 0 1 0\nf -3 -2 -1\n"))
    np.testing.assert_array_equal(corners(scene)[0], TRIANGLE)


# ---------------------------------------------------------------------------------------------------------- PLY, STL


def box() -> trimesh.Trimesh:
    return trimesh.creation.box((1, 2, 3))


def text_ply(mesh: trimesh.Trimesh, colours: np.ndarray) -> str:
    lines = ["ply", "format ascii 1.0", f"element vertex {len(mesh.vertices)}"]
    lines += [f"property float {axis}" for axis in "xyz"]
    lines += [f"element face {len(mesh.faces)}", "property list uchar int vertex_indices"]
    lines += [*(f"property uchar {colour}" for colour in ("red", "green", "blue")), "end_header"]
    lines += [" ".join(map(str, vertex)) for vertex in mesh.vertices]
    lines += [" ".join(map(str, [3, *face, *colour])) for face, colour in zip(mesh.faces, colours, strict=True)]
    return "\n".join(lines) + "\n"


@pytest.mark.parametrize("encoding", ["binary", "text"])
def test_ply_face_colours_are_srgb(tmp_path: Path, encoding: str) -> None:
    mesh = box()
    colours = np.arange(12 * 3, dtype=np.uint8).reshape(12, 3) * 7
    if encoding == "text":
        (tmp_path / "box.ply").write_text(text_ply(mesh, colours))
    else:
        mesh.visual.face_colors = colours
        mesh.export(tmp_path / "box.ply")
    scene = rad.load(tmp_path / "box.ply")
    np.testing.assert_allclose(corners(scene), mesh.triangles, atol=2 * SINGLE)
    np.testing.assert_allclose(scene.reflectance, srgb_to_linear(colours / 255), rtol=1e-14)
    assert scene.names == ("box",) * 12


def test_ply_vertex_colours_are_averaged_after_decoding(tmp_path: Path) -> None:
    mesh = box()
    mesh.visual.vertex_colors = np.tile([[255], [0]], (4, 3)).astype(np.uint8)
    mesh.export(tmp_path / "box.ply")
    whites = 1 - mesh.faces % 2
    expected = whites.sum(axis=1) / 3  # the mean of linear 0 and 1, not of their codes
    np.testing.assert_allclose(rad.load(tmp_path / "box.ply").reflectance[:, 1], expected, atol=1e-14)


def test_ply_quadrilaterals_keep_their_colours(tmp_path: Path) -> None:
    header = """ply
format ascii 1.0
element vertex 6
property float x
property float y
property float z
element face 2
property list uchar int vertex_indices
property uchar red
property uchar green
property uchar blue
end_header
0 0 0
1 0 0
1 1 0
0 1 0
1 0 -1
1 1 -1
4 0 1 2 3 255 0 0
4 1 4 5 2 0 255 0
"""
    (tmp_path / "a.ply").write_text(header)
    scene = rad.load(tmp_path / "a.ply")
    red = scene.reflectance[:, 0] == 1
    np.testing.assert_array_equal(scene.normals[red], [[0, 0, 1]] * 2)
    np.testing.assert_array_equal(scene.normals[~red], [[1, 0, 0]] * 2)
    np.testing.assert_array_equal(scene.reflectance[~red], [[0, 1, 0]] * 2)


@pytest.mark.parametrize("cut", [0.3, 0.95])
@pytest.mark.parametrize("encoding", ["binary", "ascii"])
def test_a_ply_cut_short_is_refused(tmp_path: Path, encoding: str, cut: float) -> None:
    data = box().export(file_type="ply", encoding=encoding)
    (tmp_path / "cut.ply").write_bytes(data[: int(cut * len(data))])
    with pytest.raises(ValueError, match=r"cut\.ply: "):
        rad.load(tmp_path / "cut.ply")


@pytest.mark.parametrize("kind", ["stl", "stl_ascii"])
def test_stl_keeps_corners_in_order(tmp_path: Path, kind: str) -> None:
    mesh = box()
    mesh.export(tmp_path / "box.stl", file_type=kind)  # the text form names its solid ""
    scene = rad.load(tmp_path / "box.stl")
    np.testing.assert_allclose(corners(scene), mesh.triangles, atol=2 * SINGLE)
    np.testing.assert_array_equal(scene.reflectance, np.full((12, 1), 0.5))
    assert scene.names == ("box",) * 12


def test_text_stl_names_its_solids(tmp_path: Path) -> None:
    solid = (
        "solid {}\nfacet normal 0 0 1\nouter loop\nvertex 0 0 {z}\nvertex 1 0 {z}\nvertex 0 1 {z}\nendloop\nendfacet\n"
    )
    text = solid.format("floor", z=0) + "endsolid floor\n" + solid.format("lid", z=1) + "endsolid lid\n"
    (tmp_path / "a.stl").write_text(text)
    assert rad.load(tmp_path / "a.stl").names == ("floor", "lid")
    (tmp_path / "a.stl").write_text(text.replace("endsolid lid\n", ""))
    with pytest.raises(ValueError, match=r"2 triangles are announced, but only 1 "):
        rad.load(tmp_path / "a.stl")


@pytest.mark.parametrize("kept", [40, 84, 200, -1])
def test_a_binary_stl_cut_short_is_refused(tmp_path: Path, kept: int) -> None:
    (tmp_path / "cut.stl").write_bytes(box().export(file_type="stl")[:kept])
    with pytest.raises(ValueError, match=r"cut\.stl: neither a complete binary STL file nor a text one"):
        rad.load(tmp_path / "cut.stl")


def test_point_clouds_and_empty_meshes_are_refused(tmp_path: Path) -> None:
    trimesh.PointCloud(TRIANGLE).export(tmp_path / "points.ply")
    with pytest.raises(ValueError, match=r"points\.ply: .*points and lines have no area"):
        rad.load(tmp_path / "points.ply")
    (tmp_path / "none.stl").write_bytes(bytes(84))
    with pytest.raises(ValueError, match=r"none\.stl: the mesh is empty"):
        rad.load(tmp_path / "none.stl")


# -------------------------------------------------------------------------------------------------------------- paths


def test_wrong_paths(tmp_path: Path) -> None:
    with pytest.raises(FileNotFoundError, match=r"nowhere\.glb: no such file"):
        rad.load(tmp_path / "nowhere.glb")
    (tmp_path / "folder.glb").mkdir()
    with pytest.raises(IsADirectoryError, match=r"folder\.glb: is a folder"):
        rad.load(str(tmp_path / "folder.glb"))
    (tmp_path / "scene.blend").write_bytes(b"BLENDER")
    with pytest.raises(
        ValueError, match=r"unknown extension \.blend; valid are \.glb, \.gltf, \.obj, \.ply, \.stl, \.xml"
    ):
        rad.load(tmp_path / "scene.blend")
    (tmp_path / "upper.STL").write_bytes(box().export(file_type="stl"))
    assert rad.load(tmp_path / "upper.STL").n_patches == 12


@pytest.mark.parametrize("extension", ["glb", "gltf", "obj", "ply", "stl"])
def test_garbage_is_refused(tmp_path: Path, extension: str) -> None:
    path = tmp_path / f"garbage.{extension}"
    path.write_bytes(np.random.default_rng(0).bytes(500))
    with pytest.raises(ValueError, match=rf"garbage\.{extension}: "):
        rad.load(path)


# ------------------------------------------------------------------------------------------------------------ Mitsuba


def test_mitsuba_xml(tmp_path: Path) -> None:
    pytest.importorskip("mitsuba")
    shape = """<shape type="rectangle" id="lamp">
        <bsdf type="diffuse"><rgb name="reflectance" value="0.25, 0.5, 0.75"/></bsdf>
        <emitter type="area"><rgb name="radiance" value="3, 2, 1"/></emitter></shape>"""
    (tmp_path / "lamp.xml").write_text(f'<scene version="3.0.0">{shape}</scene>')
    scene = rad.load(tmp_path / "lamp.xml")
    assert scene.areas.sum() == pytest.approx(4.0, rel=SINGLE)  # Mitsuba's rectangle is 2 x 2
    np.testing.assert_allclose(scene.reflectance, [[0.25, 0.5, 0.75]] * 2, rtol=2 * SINGLE)
    np.testing.assert_allclose(scene.emission, math.pi * np.array([[3, 2, 1]] * 2), rtol=2 * SINGLE)

    (tmp_path / "cut.xml").write_text(f'<scene version="3.0.0">{shape}')
    with pytest.raises(ValueError, match=r"cut\.xml: not a valid Mitsuba scene"):
        rad.load(tmp_path / "cut.xml")
    (tmp_path / "ball.xml").write_text('<scene version="3.0.0"><shape type="sphere"/></scene>')
    with pytest.raises(ValueError, match=r"ball\.xml: "):
        rad.load(tmp_path / "ball.xml")


# ------------------------------------------------------------------------------------------------------ from_trimesh


def test_from_trimesh_places_every_instance() -> None:
    mesh = box()
    world = trimesh.Scene()
    mirror = np.diag([-1.0, 1.0, 1.0, 1.0])
    mirror[0, 3] = 10
    world.add_geometry(mesh, node_name="one", geom_name="box")
    world.graph.update("two", geometry="box", matrix=mirror)
    scene = rad.Scene.from_trimesh(world)
    assert scene.names == ("one",) * 12 + ("two",) * 12
    np.testing.assert_array_equal(corners(scene)[:12], mesh.triangles)
    # Mirrored, and still facing outwards.
    outwards = np.einsum("ij,ij->i", scene.centroids[12:] - [10, 0, 0], scene.normals[12:])
    assert np.all(outwards > 0)
    assert scene.bands == 1


def test_from_trimesh_takes_materials_unless_told_otherwise() -> None:
    mesh = box()
    red = trimesh.visual.material.PBRMaterial(baseColorFactor=[51, 102, 204, 255], emissiveFactor=[0, 0.5, 1])
    mesh.visual = trimesh.visual.TextureVisuals(material=red)
    scene = from_trimesh(mesh)
    np.testing.assert_allclose(scene.reflectance, [[0.2, 0.4, 0.8]] * 12, rtol=1e-15)
    np.testing.assert_allclose(scene.emission, math.pi * np.array([[0, 0.5, 1]] * 12), rtol=1e-15)
    told = from_trimesh(mesh, reflectance=[0.1, 0.2, 0.3], emission=np.ones((12, 3)))
    np.testing.assert_array_equal(told.reflectance, [[0.1, 0.2, 0.3]] * 12)
    np.testing.assert_array_equal(told.emission, np.ones((12, 3)))
    # A mesh without colours takes any number of bands.
    assert from_trimesh(box(), emission=[1.0, 2.0]).bands == 2


def test_from_trimesh_mixes_meshes_with_and_without_materials() -> None:
    coloured, plain = box(), box()
    coloured.visual = trimesh.visual.TextureVisuals(
        material=trimesh.visual.material.SimpleMaterial(diffuse=[255, 0, 51, 255])
    )
    scene = from_trimesh(trimesh.Scene({"coloured": coloured, "plain": plain}))
    np.testing.assert_allclose(scene.reflectance[:12], [[1, 0, 0.2]] * 12, rtol=1e-15)
    np.testing.assert_array_equal(scene.reflectance[12:], [[0.5] * 3] * 12)


def test_from_trimesh_reads_metal_and_takes_mirrors_and_glass() -> None:
    chrome = trimesh.visual.material.PBRMaterial(
        metallicFactor=1.0, roughnessFactor=0.0, baseColorFactor=[51] * 3 + [255]
    )
    steel = trimesh.visual.material.PBRMaterial(name="steel", metallicFactor=1.0, roughnessFactor=0.5)
    boxes = [trimesh.creation.box() for _ in range(3)]
    boxes[0].visual = trimesh.visual.TextureVisuals(material=chrome)
    mesh = trimesh.Scene(boxes[:2])
    scene = from_trimesh(mesh)
    np.testing.assert_array_equal(scene.mirror, np.repeat([0.2, 0.0], 12))
    np.testing.assert_array_equal(scene.reflectance[:, 0], np.repeat([0.0, 0.5], 12))
    # A reflectance that is told makes all of it diffuse.
    for told in (0.3, np.full((24, 3), 0.3)):
        assert from_trimesh(mesh, told).is_diffuse
    glass = rad.Scene.from_trimesh(mesh, mirror=0.0, ior=np.repeat([np.nan, 1.5], 12))
    np.testing.assert_array_equal(glass.reflectance[:, 0], np.repeat([0.2, 0.0], 12))
    assert (glass.ior[12:] == 1.5).all()
    half = rad.Scene.from_trimesh(mesh, 0.7, mirror=np.repeat([0.0, 0.9], 12))
    np.testing.assert_array_equal(half.reflectance[:, 0], np.repeat([0.7, 0.0], 12))
    boxes[2].visual = trimesh.visual.TextureVisuals(material=steel)
    with pytest.warns(UserWarning, match="material 'steel' is no mirror"):
        assert from_trimesh(boxes[2]).is_diffuse


def test_from_trimesh_does_not_touch_or_share_the_mesh() -> None:
    mesh = box()
    before = mesh.vertices.copy()
    scene = from_trimesh(mesh)
    mesh.vertices += 1
    np.testing.assert_array_equal(corners(scene), before[mesh.faces])


def test_from_trimesh_refuses_what_is_no_triangle_mesh() -> None:
    with pytest.raises(TypeError, match=r"expected a trimesh\.Trimesh or trimesh\.Scene, not ndarray"):
        from_trimesh(TRIANGLE)
    with pytest.raises(ValueError, match="empty"):
        from_trimesh(trimesh.Trimesh())
    with pytest.raises(ValueError, match="empty"):
        from_trimesh(trimesh.Scene())
    world = trimesh.Scene()
    world.add_geometry(trimesh.PointCloud(TRIANGLE), node_name="dots")
    with pytest.raises(ValueError, match="'dots' is a PointCloud"):
        from_trimesh(world)


# ---------------------------------------------------------------------------------------------------------- materials


def test_srgb_endpoints_and_midpoint() -> None:
    # IEC 61966-2-1: the code 0.5 is 21.4 % of the light; both branches meet at 0.04045.
    np.testing.assert_allclose(srgb_to_linear([0, 0.5, 1]), [0, 0.21404114, 1], atol=5e-9)
    low, high = srgb_to_linear([0.04045, 0.04045 + 1e-9])
    assert high - low == pytest.approx(0, abs=1e-7)  # the standard's rounded constants leave a step of 3e-8


@pytest.mark.parametrize("size", [1, 7, 64, 500])
def test_texture_means_reach_the_mean_of_the_image(size: int) -> None:
    pixels = np.random.default_rng(size).integers(0, 256, (size, size, 3), dtype=np.uint8)
    linear = srgb_to_linear(pixels / 255)
    square = np.array([[[0, 0], [1, 0], [1, 1]], [[0, 0], [1, 1], [0, 1]]], dtype=float)
    means = texture_means(Image.fromarray(pixels), square)
    # Random texels differ by 0.3; 64 samples of a level of as many texels, and the odd rows of 7 and 500, leave
    # 0.3 / 8 and less as the texels of the level grow smoother. Two triangles together halve the variance.
    bound = 1e-12 if size == 1 else 4 * 0.3 / math.sqrt(2 * 64)
    np.testing.assert_allclose(means.mean(axis=0), linear.mean(axis=(0, 1)), atol=bound)
    # Repeated outside [0, 1]: 5 and -3 are whole periods, and exact in binary.
    np.testing.assert_allclose(texture_means(Image.fromarray(pixels), square + np.array([5, -3])), means, atol=1e-12)
