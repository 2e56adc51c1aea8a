//! Pictures with a known content: where it is, how bright it is, and what is told when there is none.

use std::f64::consts::PI;

use radiosity::geometry::Vec3;
use radiosity::render::{Camera, Corners, Image, Shading, render};
use radiosity::scene::{Scene, Sides};
use radiosity::visibility::Bvh;
use radiosity::{Error, Progress, Result};

use crate::common::{Mesh, PLENTY, Random, assert_close, box_in_box, cube, invalid, on_threads, plate, vec3};

/// A size, and whether the picture is smooth.
type Size = (usize, usize, bool);

fn try_picture(scene: &Scene, irradiance: &[f64], camera: &Camera, (width, height, smooth): Size) -> Result<Vec<f64>> {
    let radiosity: Vec<f64> =
        (0..irradiance.len()).map(|k| scene.emission()[k] + scene.reflectance()[k] * irradiance[k]).collect();
    let corners = Corners::new(scene);
    let shading = if smooth { Shading::Smooth(&corners, irradiance) } else { Shading::Flat(&radiosity) };
    let image = Image { width, height, shading };
    render(scene, &Bvh::of_scene(scene), camera, image, PLENTY, &Progress::default())
}

fn picture(scene: &Scene, irradiance: &[f64], camera: &Camera, size: Size) -> Vec<f64> {
    try_picture(scene, irradiance, camera, size).unwrap()
}

fn flat(width: usize, height: usize) -> Size {
    (width, height, false)
}

fn smooth(width: usize, height: usize) -> Size {
    (width, height, true)
}

/// At height 1 above the origin, looking down, x to the right and y up; the square [-1, 1]^2 of the floor fills the view.
fn above() -> Camera {
    Camera::new(Vec3::Z, Vec3::ZERO, Vec3::Y, 90.0).unwrap()
}

/// The square [-1, 1]^2 of the plane z = 0, k x k cells, front up.
fn floor(k: usize) -> Mesh {
    plate(vec3(-1.0, -1.0, 0.0), 2.0 * Vec3::X, 2.0 * Vec3::Y, k)
}

#[test]
fn the_middle_of_the_picture_looks_at_the_target() {
    let random = Random::new(61);
    for _ in 0..100 {
        let (origin, target, fov) = (10.0 * random.in_cube(), 10.0 * random.in_cube(), random.between(1.0, 170.0));
        let up = random.direction();
        let camera = Camera::new(origin, target, up, fov).unwrap();
        assert_eq!(camera.origin(), origin);
        let (width, height) = (40, 30);
        let at = |x: f64, y: f64| camera.direction(x, y, width, height);
        let view = (target - origin).normalize();
        // Unit vectors after a handful of operations; cosines near 1 are exact to 1e-16, sines are what is compared.
        assert!(at(20.0, 15.0).normalize().distance(view) < 1e-14);
        // The field of view is vertical: half of it to the upper and to the lower edge.
        let tangent = (0.5 * fov.to_radians()).tan();
        let slope = |d: Vec3, axis: Vec3| d.dot(axis) / d.dot(view);
        let right = view.cross(up).normalize();
        let upward = right.cross(view);
        for (x, y, to_right, to_top) in [
            (20.0, 0.0, 0.0, 1.0),
            (20.0, 30.0, 0.0, -1.0),
            (40.0, 15.0, 4.0 / 3.0, 0.0),
            (0.0, 15.0, -4.0 / 3.0, 0.0),
            (0.0, 0.0, -4.0 / 3.0, 1.0),
        ] {
            assert_close(slope(at(x, y), right), to_right * tangent, 1e-12 * tangent);
            assert_close(slope(at(x, y), upward), to_top * tangent, 1e-12 * tangent);
        }
    }
}

#[test]
fn cameras_that_are_none_are_refused() {
    let camera = |origin: Vec3, target: Vec3, up: Vec3, fov: f64| invalid(Camera::new(origin, target, up, fov));
    for fov in [0.0, 180.0, -10.0, f64::NAN] {
        assert!(camera(Vec3::ZERO, Vec3::X, Vec3::Z, fov).contains("fov"));
    }
    assert!(camera(Vec3::X, Vec3::X, Vec3::Z, 40.0).contains("same point"));
    assert!(camera(Vec3::ZERO, Vec3::Z, -2.0 * Vec3::Z, 40.0).contains("parallel"));
    assert!(camera(Vec3::ZERO, Vec3::Z, Vec3::ZERO, 40.0).contains("up"));
    let text = camera(Vec3::NAN, Vec3::INFINITY, Vec3::NAN, 400.0);
    assert_eq!(text.lines().count(), 4, "{text}");
}

#[test]
fn a_plate_seen_face_on_shines_with_b_over_pi() {
    // The plate fills the middle half of the view: pixels 8 to 23 of 32.
    let scene = floor(3).map(|v| 0.5 * v).scene_with(2, Sides::Front, |_, _| 0.0, |_, b| 2.0 + b as f64);
    let dark = vec![0.0; 2 * scene.len()];
    for image in [flat(32, 32), smooth(32, 32)] {
        let pixels = picture(&scene, &dark, &above(), image);
        assert_eq!(pixels.len(), 32 * 32 * 2);
        for (k, value) in pixels.iter().enumerate() {
            let (x, y, b) = (k / 2 % 32, k / 64, k % 2);
            let covered = (8..24).contains(&x) && (8..24).contains(&y);
            // A mean of up to 16 equal numbers.
            let exact = if covered { (2.0 + b as f64) / PI } else { 0.0 };
            assert_close(*value, exact, 1e-15);
        }
    }
}

#[test]
fn row_0_is_on_top_and_x_runs_to_the_right() {
    // Quadrants of the floor, as seen from above: 1 upper left, 2 upper right, 3 lower left, 4 lower right.
    let quadrant = |scene: &Scene, i: usize| {
        let centre = scene.triangle(i).iter().sum::<Vec3>() / 3.0;
        1.0 + if centre.x > 0.0 { 1.0 } else { 0.0 } + if centre.y < 0.0 { 2.0 } else { 0.0 }
    };
    let grid = floor(2).scene();
    let scene = floor(2).scene_with(1, Sides::Front, |_, _| 0.0, |i, _| quadrant(&grid, i));
    let dark = vec![0.0; scene.len()];
    let pixels = picture(&scene, &dark, &above(), flat(8, 6));
    for (k, value) in pixels.iter().enumerate() {
        let (x, y) = (k % 8, k / 8);
        // 8 x 6 pixels show [-4/3, 4/3] x [-1, 1]: the outer columns are half in the void beside the floor.
        if (1..7).contains(&x) {
            let expected = 1.0 + if x >= 4 { 1.0 } else { 0.0 } + if y >= 3 { 2.0 } else { 0.0 };
            assert_close(*value, expected / PI, 1e-15);
        }
    }
    // With y to the right of the picture the quadrants turn: up is -x then, and left -y.
    let turned = Camera::new(Vec3::Z, Vec3::ZERO, -Vec3::X, 90.0).unwrap();
    let pixels = picture(&scene, &dark, &turned, flat(2, 2));
    for (value, expected) in pixels.iter().zip([3.0, 1.0, 4.0, 2.0]) {
        assert_close(*value, expected / PI, 1e-15);
    }
}

#[test]
fn pixels_are_averages() {
    // An odd number of pixels over a floor that is bright for x > 0: the border runs through the middle of one column.
    let grid = floor(2).scene();
    let bright = |i: usize| grid.triangle(i).iter().sum::<Vec3>().x > 0.0;
    let scene = floor(2).scene_with(1, Sides::Front, |_, _| 0.0, |i, _| if bright(i) { PI } else { 0.0 });
    let pixels = picture(&scene, &vec![0.0; scene.len()], &above(), flat(9, 9));
    for row in pixels.chunks_exact(9) {
        assert_eq!(row[..4], [0.0; 4]);
        // Sixteen stratified rays, eight of them in either half.
        assert_close(row[4], 0.5, 1e-15);
        row[5..].iter().for_each(|value| assert_close(*value, 1.0, 1e-15));
    }
}

#[test]
fn backs_are_black() {
    // Left half front up, right half wound the other way.
    let left = plate(vec3(-1.0, -1.0, 0.0), Vec3::X, 2.0 * Vec3::Y, 2);
    let right = plate(vec3(0.0, -1.0, 0.0), Vec3::X, 2.0 * Vec3::Y, 2).reversed();
    let scene = left.and(&right).scene_with(1, Sides::Front, |_, _| 0.5, |_, _| PI);
    for image in [flat(8, 8), smooth(8, 8)] {
        let pixels = picture(&scene, &vec![0.0; scene.len()], &above(), image);
        for row in pixels.chunks_exact(8) {
            row[..4].iter().for_each(|value| assert_close(*value, 1.0, 1e-15));
            assert_eq!(row[4..], [0.0; 4]);
        }
    }
}

#[test]
fn both_sides_of_a_sheet_have_their_own_light() {
    let scene = floor(2).scene_with(1, Sides::Both, |_, _| 1.0, |_, _| 0.0);
    let n = scene.len();
    let irradiance: Vec<f64> = (0..n).map(|i| if i < n / 2 { PI } else { 3.0 * PI }).collect();
    let below = Camera::new(-Vec3::Z, Vec3::ZERO, Vec3::Y, 90.0).unwrap();
    for image in [flat(4, 4), smooth(4, 4)] {
        picture(&scene, &irradiance, &above(), image).iter().for_each(|value| assert_close(*value, 1.0, 1e-15));
        picture(&scene, &irradiance, &below, image).iter().for_each(|value| assert_close(*value, 3.0, 4e-15));
    }
}

#[test]
fn pictures_of_nothing_are_refused_with_the_reason() {
    let scene = floor(1).scene();
    let dark = vec![0.0; scene.len()];
    let text = |camera: Camera, size: Size| invalid(try_picture(&scene, &dark, &camera, size));
    let away = Camera::new(Vec3::Z, 2.0 * Vec3::Z, Vec3::Y, 90.0).unwrap();
    assert!(text(away, flat(8, 8)).contains("looks at nothing"));
    let below = Camera::new(vec3(0.1, 0.2, -3.0), Vec3::ZERO, Vec3::Y, 90.0).unwrap();
    let backs = text(below, flat(8, 8));
    assert!(backs.contains("only the backs of patches (patch 0 among them)"), "{backs}");
    assert!(backs.contains("0.1") && backs.contains("-3"), "the camera is not named: {backs}");
    for (width, height) in [(0, 8), (8, 0), (0, 0)] {
        assert!(text(above(), flat(width, height)).contains(&format!("{width} x {height} pixels")));
    }
    // A camera outside a closed room.
    let room = cube(1).scene();
    let outside = Camera::new(vec3(5.0, 4.0, 3.0), Vec3::splat(0.5), Vec3::Z, 40.0).unwrap();
    assert!(
        invalid(try_picture(&room, &vec![0.0; room.len()], &outside, flat(8, 8))).contains("outside a closed room")
    );
}

#[test]
fn a_small_target_in_the_middle_of_the_picture_is_seen() {
    // 7 x 7 pixels of 512 x 512.
    let scene = floor(1).map(|v| 0.5 * v).scene_with(1, Sides::Front, |_, _| 0.0, |_, _| PI);
    let camera = Camera::new(100.0 * Vec3::Z, Vec3::ZERO, Vec3::Y, 40.0).unwrap();
    let pixels = picture(&scene, &vec![0.0; scene.len()], &camera, flat(512, 512));
    assert!(pixels.iter().sum::<f64>() > 36.0);
}

#[test]
fn smooth_shading_of_constant_irradiance_is_flat() {
    let scene = box_in_box(3).scene_with(
        3,
        Sides::Front,
        |i, b| (1 + (i + b) % 7) as f64 / 10.0,
        |i, b| if i % 11 == b { 5.0 } else { 0.0 },
    );
    let irradiance = vec![2.0; 3 * scene.len()];
    let camera = Camera::new(vec3(0.05, 0.1, 0.9), vec3(0.6, 0.6, 0.3), Vec3::Z, 80.0).unwrap();
    let (a, b) =
        (picture(&scene, &irradiance, &camera, flat(40, 30)), picture(&scene, &irradiance, &camera, smooth(40, 30)));
    assert!(a.iter().all(|value| *value > 0.0), "the room is closed");
    for (a, b) in a.iter().zip(&b) {
        // Weights that sum to 1 up to rounding.
        assert_close(*b, *a, 1e-14);
    }
}

#[test]
fn smooth_shading_keeps_lamps_and_paints_within_their_borders() {
    // 4 x 4 cells of 16 x 16 pixels; in one row of cells one is a lamp and one is painted. Two patches a cell.
    let lamp = |i: usize| i / 2 == 5;
    let paint = |i: usize| i / 2 == 6;
    let scene = floor(4).scene_with(
        1,
        Sides::Front,
        |i, _| if paint(i) { 0.9 } else { 0.3 },
        |i, _| if lamp(i) { 100.0 } else { 0.0 },
    );
    let pixels = picture(&scene, &vec![2.0; scene.len()], &above(), smooth(64, 64));
    for (k, value) in pixels.iter().enumerate() {
        // Cells are numbered from below.
        let cell = (63 - k / 64) / 16 * 4 + k % 64 / 16;
        let exact = match cell {
            5 => 100.0 + 0.3 * 2.0,
            6 => 0.9 * 2.0,
            _ => 0.3 * 2.0,
        };
        assert_close(*value, exact / PI, 1e-14 * exact);
    }
}

#[test]
fn smooth_shading_reproduces_a_gradient() {
    // Irradiance linear in x at the centroids. Around a corner inside the grid the six patches lie symmetrically, so its
    // mean is exact, and interpolation gives the line back.
    let line = |x: f64| 3.0 + x;
    let grid = floor(8).scene();
    let irradiance: Vec<f64> = (0..grid.len()).map(|i| line(grid.triangle(i).iter().sum::<Vec3>().x / 3.0)).collect();
    let scene = floor(8).scene_with(1, Sides::Front, |_, _| 0.5, |_, _| 0.0);
    let error = |size: Size| {
        let pixels = picture(&scene, &irradiance, &above(), size);
        let mut worst = 0.0f64;
        // The inner 6 x 6 cells of 8 pixels.
        for (x, y) in (8..56).flat_map(|x: u32| (8..56).map(move |y| (x, y))) {
            let exact = 0.5 * line((f64::from(x) + 0.5) / 32.0 - 1.0) / PI;
            worst = worst.max((pixels[(y * 64 + x) as usize] - exact).abs());
        }
        worst * PI / 0.5
    };
    // A ray through the middle of each pixel: the line itself, to rounding.
    assert!(error(smooth(64, 64)) < 1e-13, "{}", error(smooth(64, 64)));
    // Flat patches are off by up to two thirds of a cell of width 1/4.
    assert!(error(flat(64, 64)) > 0.1, "{}", error(flat(64, 64)));
}

#[test]
fn smooth_shading_keeps_creases() {
    // A floor and a wall on its far edge, at a right angle, with very different light.
    let wall = plate(vec3(-1.0, 1.0, 0.0), 2.0 * Vec3::X, 2.0 * Vec3::Z, 4);
    let mesh = floor(4).and(&wall);
    let scene = mesh.scene_with(1, Sides::Front, |_, _| 1.0, |_, _| 0.0);
    assert_eq!((scene.normals()[0], scene.normals()[32]), (Vec3::Z, -Vec3::Y));
    let irradiance: Vec<f64> = (0..scene.len()).map(|i| if i < 32 { PI } else { 5.0 * PI }).collect();
    // From above the far half of the floor fills the picture up to the very edge, in front of the wall.
    let pixels = picture(&scene, &irradiance, &above(), smooth(16, 16));
    pixels.iter().for_each(|value| assert_close(*value, 1.0, 1e-14));
    // Bent by 30 degrees they are one surface, and the light runs over.
    let (sine, cosine) = 30f64.to_radians().sin_cos();
    let slope = plate(vec3(-1.0, 1.0, 0.0), 2.0 * Vec3::X, 2.0 * vec3(0.0, cosine, sine), 4);
    let scene = floor(4).and(&slope).scene_with(1, Sides::Front, |_, _| 1.0, |_, _| 0.0);
    let pixels = picture(&scene, &irradiance, &above(), smooth(16, 16));
    assert!(pixels[..16].iter().all(|value| *value > 1.5), "{:?}", &pixels[..16]);
    pixels[64..].iter().for_each(|value| assert_close(*value, 1.0, 1e-14));
}

#[test]
fn pictures_do_not_depend_on_the_number_of_threads() {
    let scene = box_in_box(2).scene();
    let random = Random::new(62);
    let irradiance: Vec<f64> = (0..scene.len()).map(|_| random.uniform()).collect();
    let camera = Camera::new(vec3(0.05, 0.1, 0.9), vec3(0.6, 0.6, 0.3), Vec3::Z, 80.0).unwrap();
    let bits = |threads: usize| {
        on_threads(threads, || {
            picture(&scene, &irradiance, &camera, smooth(50, 40)).iter().map(|v| v.to_bits()).collect::<Vec<_>>()
        })
    };
    let one = bits(1);
    assert_eq!(bits(2), one);
    assert_eq!(bits(7), one);
}

#[test]
fn stopping_interrupts_a_picture() {
    let scene = floor(1).scene();
    let dark = vec![0.0; scene.len()];
    let image = Image { width: 8, height: 8, shading: Shading::Flat(&dark) };
    let progress = Progress::default();
    progress.stop();
    let outcome = render(&scene, &Bvh::of_scene(&scene), &above(), image, PLENTY, &progress);
    assert!(matches!(outcome, Err(Error::Interrupted)));
    let progress = Progress::default();
    render(&scene, &Bvh::of_scene(&scene), &above(), image, PLENTY, &progress).unwrap();
    assert_eq!(progress.get(), (8, 8));
}

#[test]
fn pictures_that_do_not_fit_are_refused() {
    let scene = floor(1).scene();
    let dark = vec![0.0; scene.len()];
    let image = Image { width: 100, height: 50, shading: Shading::Flat(&dark) };
    let picture = |memory: u64| render(&scene, &Bvh::of_scene(&scene), &above(), image, memory, &Progress::default());
    // The image and a copy of it, 8 bytes a number.
    assert!(picture(16 * 5000).is_ok());
    match picture(16 * 5000 - 1) {
        Err(Error::Memory { needed, .. }) => assert_eq!(needed, 16 * 5000),
        other => panic!("{:?}", other.map(|pixels| pixels.len())),
    }
}

#[test]
fn pictures_beyond_64_bits_are_refused() {
    let scene = floor(1).scene();
    let dark = vec![0.0; scene.len()];
    let outcome = try_picture(&scene, &dark, &above(), flat(usize::MAX, usize::MAX));
    assert!(matches!(outcome, Err(Error::Memory { .. })));
}
