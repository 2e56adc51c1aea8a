//! Validation tells everything at once; two-sided scenes are what they say; subdivision carries materials along.

use radiosity::Progress;
use radiosity::geometry::Vec3;
use radiosity::scene::{Description, Scene, Sides};

use crate::common::{Mesh, PLENTY, assert_close, cube, icosphere, invalid, plate, two_plates, vec3};

/// Three sound triangles side by side, 2 bands.
fn three() -> Description {
    let triangles = [0.0, 1.0, 2.0].map(|x| [vec3(x, 0.0, 0.0), vec3(x + 1.0, 0.0, 0.0), vec3(x, 1.0, 0.0)]);
    let mesh = Mesh::of_triangles(&triangles);
    Description {
        vertices: mesh.vertices,
        faces: mesh.faces,
        bands: 2,
        reflectance: vec![0.5; 6],
        emission: vec![1.0; 6],
        materials: vec![],
        sides: Sides::Front,
    }
}

#[track_caller]
fn assert_says(text: &str, wanted: &[&str]) {
    for wanted in wanted {
        assert!(text.lines().any(|line| line.contains(wanted)), "no line says \"{wanted}\":\n{text}");
    }
    assert_eq!(text.lines().count(), wanted.len(), "one line a problem:\n{text}");
}

#[test]
fn a_sound_description_is_accepted_as_it_is() {
    let description = three();
    let scene = Scene::new(description.clone()).unwrap();
    assert_eq!((scene.len(), scene.bands(), scene.is_empty()), (3, 2, false));
    assert_eq!(scene.vertices(), description.vertices);
    assert_eq!(scene.reflectance(), description.reflectance);
    assert_eq!(scene.emission(), description.emission);
    assert_eq!(scene.areas(), [0.5; 3]);
    assert_eq!(scene.normals(), [Vec3::Z; 3]);
    assert_eq!(scene.triangle(2), [vec3(2.0, 0.0, 0.0), vec3(3.0, 0.0, 0.0), vec3(2.0, 1.0, 0.0)]);
    assert_eq!(scene.plane(1).distance(vec3(7.0, 8.0, 3.0)), 3.0);
}

#[test]
fn every_problem_of_values_is_told_with_its_patch() {
    let mut bad = three();
    bad.vertices[2] = vec3(0.5, 0.0, 0.0);
    bad.reflectance[1] = 1.2;
    bad.reflectance[2] = f64::NAN;
    bad.reflectance[5] = -0.1;
    bad.emission[0] = -3.0;
    bad.emission[3] = f64::INFINITY;
    let text = invalid(Scene::new(bad));
    assert_says(
        &text,
        &[
            "patch 0: area 0e0 m^2 is zero",
            "patch 0: reflectance 1.2 is outside [0, 1] (band 1)",
            "patch 1: reflectance NaN is outside [0, 1] (band 0)",
            "patch 2: reflectance -0.1 is outside [0, 1] (band 1)",
            "patch 0: emission -3 is outside [0, inf) (band 0)",
            "patch 1: emission inf is outside [0, inf) (band 1)",
        ],
    );
}

#[test]
fn every_problem_of_shapes_is_told_with_its_patch() {
    let mut bad = three();
    bad.vertices[3].y = f64::NAN;
    bad.vertices[8].z = f64::NEG_INFINITY;
    bad.faces[0][1] = -1;
    bad.faces[2][2] = 9;
    bad.reflectance.pop();
    bad.emission.push(0.0);
    let text = invalid(Scene::new(bad));
    assert_says(
        &text,
        &[
            "reflectance has 5 values; 3 patches of 2 bands need 6",
            "emission has 7 values; 3 patches of 2 bands need 6",
            "vertex 3 is (1, NaN, 0)",
            "vertex 8 is (2, 1, -inf)",
            "patch 0: vertex index -1 is outside 0 .. 9",
            "patch 2: vertex index 9 is outside 0 .. 9",
        ],
    );
    let empty =
        Description { vertices: vec![], faces: vec![], bands: 0, reflectance: vec![], emission: vec![], ..three() };
    assert_says(&invalid(Scene::new(empty)), &["the scene has no patches", "the scene has no bands"]);
}

#[test]
fn problems_of_shapes_and_values_are_told_together() {
    let mut bad = three();
    bad.faces[0][1] = 99;
    bad.reflectance[5] = 1.2;
    let text = invalid(Scene::new(bad));
    assert_says(&text, &["patch 0: vertex index 99", "patch 2: reflectance 1.2"]);
}

#[test]
fn many_problems_of_one_kind_are_counted() {
    let text = invalid(cube(2).try_scene(1, Sides::Front, |i, _| if i < 20 { 2.0 } else { 0.5 }, |_, _| 0.0));
    assert_eq!(text.lines().count(), 9, "{text}");
    assert!(text.lines().nth(7).is_some_and(|line| line.contains("patch 7: reflectance 2")), "{text}");
    assert!(text.ends_with("... and 12 more of this kind"), "{text}");
}

#[test]
fn zero_area_is_judged_by_the_shape_not_by_the_size() {
    let triangle = |height: f64, scale: f64| {
        let corners = [Vec3::ZERO, vec3(1.0, 0.0, 0.0), vec3(0.5, height, 0.0)].map(|v| scale * v);
        Mesh::of_triangles(&[corners]).try_scene(1, Sides::Front, |_, _| 0.5, |_, _| 0.0)
    };
    for scale in [1e-9, 1.0, 1e9] {
        assert!(triangle(1.0, scale).is_ok(), "scale {scale}");
        assert!(triangle(1e-9, scale).is_ok(), "a needle at scale {scale}: thin, not flat");
        assert!(invalid(triangle(0.0, scale)).contains("patch 0: area"));
        assert!(invalid(triangle(1e-17, scale)).contains("patch 0: area"), "below the rounding of the edges");
    }
    // Squares of such lengths leave the range of normal numbers.
    assert!(invalid(triangle(1.0, 1e-160)).contains("is zero"));
}

#[test]
fn a_patch_that_repeats_another_is_named_and_its_back_is_not() {
    let plate =
        |faces: &[[i64; 3]]| Mesh { vertices: vec![Vec3::ZERO, Vec3::X, Vec3::Y, Vec3::Z], faces: faces.to_vec() };
    let distinct = plate(&[[0, 1, 2], [0, 2, 1], [0, 1, 3]]).scene();
    assert!(distinct.require_distinct("this").is_ok());
    // Wherever it starts, and whichever of several vertices in one place it names.
    let mut again = plate(&[[0, 1, 2], [0, 1, 3], [4, 0, 1]]);
    again.vertices.push(vec3(0.0, 1.0, -0.0));
    assert_says(
        &again.scene().require_distinct("this").unwrap_err().to_string(),
        &["patch 2 repeats patch 0, corner by corner, and this would count the light of both"],
    );
}

#[test]
fn both_sides_double_and_reverse() {
    let mesh = two_plates(2);
    let n = mesh.faces.len();
    let value = |i: usize, b: usize| (3 * i + b) as f64 / 64.0;
    let front = mesh.scene_with(3, Sides::Front, value, value);
    let both = mesh.scene_with(3, Sides::Both, value, value);
    assert_eq!((front.len(), both.len()), (n, 2 * n));
    for i in 0..n {
        assert_eq!(both.faces()[i], front.faces()[i]);
        let [a, b, c] = both.faces()[i];
        assert_eq!(both.faces()[i + n], [a, c, b]);
        assert_eq!(both.normals()[i + n], -both.normals()[i]);
        assert_eq!(both.areas()[i + n], both.areas()[i]);
    }
    for values in [both.reflectance(), both.emission()] {
        assert_eq!(values[..3 * n], values[3 * n..]);
        assert_eq!(values[..3 * n], *front.reflectance());
    }
}

#[test]
fn perfect_reflectance_everywhere_needs_a_way_out() {
    let white = |mesh: &Mesh| mesh.try_scene(2, Sides::Front, |_, band| if band == 1 { 1.0 } else { 0.5 }, |_, _| 1.0);
    for mesh in [cube(2), icosphere(1).reversed()] {
        let text = invalid(white(&mesh));
        assert!(text.contains("closed") && text.contains("band 1") && !text.contains("band 0"), "{text}");
        // One patch missing: light leaves.
        let mut open = mesh.clone();
        open.faces.pop();
        assert!(white(&open).is_ok());
        // One patch that absorbs a little.
        let last = mesh.faces.len() - 1;
        let grey = mesh.try_scene(1, Sides::Front, |i, _| if i == last { 0.999 } else { 1.0 }, |_, _| 1.0);
        assert!(grey.is_ok());
    }
    assert!(white(&two_plates(1)).is_ok());
}

#[test]
fn a_closed_scene_is_recognised_by_the_position_of_its_corners() {
    let mesh = cube(2).map(|v| v - Vec3::splat(0.5));
    // Every triangle has its own corners, and every other zero its own sign.
    let mut triangles: Vec<_> = mesh.indices().iter().map(|f| f.map(|v| mesh.vertices[v as usize])).collect();
    for t in triangles.iter_mut().step_by(2) {
        t.iter_mut().for_each(|v| *v = v.map(|x| if x == 0.0 { -0.0 } else { x }));
    }
    let separate = Mesh::of_triangles(&triangles);
    assert!(triangles.as_flattened().iter().any(|v| v.to_array().iter().any(|x| *x == 0.0 && x.is_sign_negative())));
    let text = invalid(separate.try_scene(1, Sides::Front, |_, _| 1.0, |_, _| 1.0));
    assert!(text.contains("closed"), "{text}");
}

#[test]
fn what_looks_outward_is_open() {
    let white = |mesh: &Mesh, sides| mesh.try_scene(1, sides, |_, _| 1.0, |_, _| 1.0);
    // A sheet with two sides shares every edge in both directions, yet encloses nothing.
    assert!(white(&plate(Vec3::ZERO, Vec3::X, Vec3::Y, 2), Sides::Both).is_ok());
    // Nothing that leaves the outside of a solid comes back.
    assert!(white(&cube(1).reversed(), Sides::Front).is_ok());
    assert!(white(&icosphere(1), Sides::Front).is_ok());
}

#[test]
fn curved_sheets_with_two_sides_are_open() {
    for drop in 1..40 {
        let mut bowl = icosphere(1);
        bowl.faces.truncate(bowl.faces.len() - drop);
        assert!(bowl.try_scene(1, Sides::Both, |_, _| 1.0, |_, _| 1.0).is_ok(), "all but {drop} triangles of a sphere");
    }
}

#[test]
fn a_sheet_of_two_patches_encloses_nothing() {
    // Front, back, front, back: not the order in which `Sides::Both` would give them.
    let mut sheet = plate(Vec3::ZERO, Vec3::X, Vec3::Y, 2).map(|v| vec3(v.x, v.y, 0.3 * v.x * v.y + 0.1));
    sheet.faces = sheet.faces.iter().flat_map(|&[a, b, c]| [[a, b, c], [a, c, b]]).collect();
    assert!(sheet.try_scene(1, Sides::Front, |_, _| 1.0, |_, _| 1.0).is_ok());
}

#[test]
fn a_white_room_with_two_sides_is_closed() {
    for room in [cube(1), cube(1).reversed()] {
        assert!(invalid(room.try_scene(1, Sides::Both, |_, _| 1.0, |_, _| 1.0)).contains("closed"));
    }
}

#[test]
fn subdivision_carries_materials_to_the_pieces() {
    let value = |i: usize, b: usize| (2 * i + b) as f64 / 100.0;
    let coarse = icosphere(0).scene_with(2, Sides::Front, value, |i, b| 1.0 + value(i, b));
    let (fine, parent) = coarse.subdivide(0.4, PLENTY, &Progress::default()).unwrap();
    assert!(fine.len() >= 4 * coarse.len());
    assert_eq!(parent.len(), fine.len());
    for (i, &p) in parent.iter().enumerate() {
        let (i, p) = (2 * i, 2 * p as usize);
        assert_eq!(fine.reflectance()[i..i + 2], coarse.reflectance()[p..p + 2]);
        assert_eq!(fine.emission()[i..i + 2], coarse.emission()[p..p + 2]);
    }
    // Some hundred pieces of an area of about 10, each known to a few ulp.
    assert_close(fine.areas().iter().sum(), coarse.areas().iter().sum(), 1e-13);
    assert!(invalid(coarse.subdivide(0.0, PLENTY, &Progress::default())).contains("max_edge 0"));
    assert!(invalid(coarse.subdivide(f64::NAN, PLENTY, &Progress::default())).contains("max_edge NaN"));
}

#[test]
fn subdivision_keeps_backs_behind_their_fronts() {
    // Two sides with materials of their own, given as patches i and i + n.
    let mut mesh = two_plates(1).map(|v| v * vec3(1.0, 0.6, 1.0));
    let n = mesh.faces.len();
    mesh.faces.extend(mesh.faces.clone().iter().map(|&[a, b, c]| [a, c, b]));
    let scene = mesh.scene_with(1, Sides::Front, |i, _| i as f64 / 10.0, |_, _| 0.0);
    let (fine, parent) = scene.subdivide(0.5, PLENTY, &Progress::default()).unwrap();
    let half = fine.len() / 2;
    assert!(half >= 4 * n);
    for i in 0..half {
        let [a, b, c] = fine.faces()[i];
        assert_eq!(fine.faces()[i + half], [a, c, b]);
        assert!((parent[i] as usize) < n && parent[i + half] == parent[i] + n as u32);
        for i in [i, i + half] {
            assert_eq!(fine.reflectance()[i], f64::from(parent[i]) / 10.0);
            assert_eq!(fine.normals()[i], scene.normals()[parent[i] as usize]);
        }
    }
}
