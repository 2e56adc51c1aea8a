//! Form factors against closed forms (Howell's catalogue), against each other, and against the symmetries of space.

use radiosity::form_factor::area_quadrature::kernel;
use radiosity::form_factor::occluded::{End, VisibleFraction, visible_fraction};
use radiosity::form_factor::{Accuracy, Batch, Kernel, Patch, Shape, exchange, point_to_polygon};
use radiosity::geometry::polygon::{Plane, area, clip_to_front};
use radiosity::geometry::quadrature::TriangleRule;
use radiosity::geometry::{Triangle, Vec3};
use radiosity::visibility::{Bvh, Instructions};

use crate::common::{Mesh, Random, assert_close, invalid, plate, rotated, two_plates, vec3};

/// G of two polygons at a tolerance.
fn g(a: &[Vec3], b: &[Vec3], tolerance: f64) -> f64 {
    exchange(&Shape::new(a), &Shape::new(b), &Accuracy::new(tolerance).unwrap())
}

/// F to 1e-8.
fn f(a: &[Vec3], b: &[Vec3]) -> f64 {
    g(a, b, 1e-8) / area(a)
}

/// G by one kernel.
fn by(kernel: Kernel, a: &Shape, b: &Shape) -> f64 {
    exchange(a, b, &Accuracy::by(kernel).unwrap())
}

/// The rectangle with corners p, p + u, p + u + v, p + v; front along u x v.
fn rectangle(p: Vec3, u: Vec3, v: Vec3) -> [Vec3; 4] {
    [p, p + u, p + u + v, p + v]
}

/// Identical, directly opposed rectangles x by y, in units of their distance (Howell, Menguc, Daun & Siegel, "Thermal
/// Radiation Heat Transfer", catalogue of configuration factors, C-11).
fn howell_c11(x: f64, y: f64) -> f64 {
    let (rx, ry) = (1.0f64.hypot(x), 1.0f64.hypot(y));
    2.0 / (std::f64::consts::PI * x * y)
        * ((rx * ry / 1.0f64.hypot(x.hypot(y))).ln() + x * ry * (x / ry).atan() + y * rx * (y / rx).atan()
            - x * x.atan()
            - y * y.atan())
}

/// Rectangles at a right angle with a common edge: from w by 1 to h by 1 (ibid., C-14).
fn howell_c14(w: f64, h: f64) -> f64 {
    let (w2, h2) = (w * w, h * h);
    let d = w.hypot(h);
    let logarithm = ((1.0 + w2) * (1.0 + h2) / (1.0 + w2 + h2)).ln()
        + w2 * (w2 * (1.0 + w2 + h2) / ((1.0 + w2) * (w2 + h2))).ln()
        + h2 * (h2 * (1.0 + w2 + h2) / ((1.0 + h2) * (w2 + h2))).ln();
    (w * (1.0 / w).atan() + h * (1.0 / h).atan() - d * (1.0 / d).atan() + 0.25 * logarithm) / (std::f64::consts::PI * w)
}

#[test]
fn opposed_rectangles_howell_c11() {
    for (width, depth) in [(1.0, 1.0), (2.0, 0.5)] {
        for gap in [10.0, 1.0, 0.1, 1e-3] {
            let a = rectangle(Vec3::ZERO, width * Vec3::X, depth * Vec3::Y);
            let b = rectangle(gap * Vec3::Z, depth * Vec3::Y, width * Vec3::X);
            let exact = howell_c11(width / gap, depth / gap);
            // The relative tolerance asked for.
            assert_close(f(&a, &b), exact, 1e-8 * exact);
        }
    }
    // The formula is the one meant: its value for cubes is in every textbook.
    assert_close(howell_c11(1.0, 1.0), 0.199_824_895_698_387, 1e-14);
}

#[test]
fn rectangles_at_a_right_angle_howell_c14() {
    for (w, h) in [(1.0, 1.0), (1.0, 0.1), (0.1, 1.0), (5.0, 0.5), (0.01, 0.01), (3.0, 20.0)] {
        let a = rectangle(Vec3::ZERO, w * Vec3::X, Vec3::Y);
        let b = rectangle(Vec3::ZERO, Vec3::Y, h * Vec3::Z);
        let exact = howell_c14(w, h);
        assert_close(f(&a, &b), exact, 1e-8 * exact);
        // The contour integral is exact but for rounding, and the closed form loses a few digits itself.
        assert_close(by(Kernel::Contour, &Shape::new(&a), &Shape::new(&b)) / w, exact, 1e-12);
    }
    assert_close(howell_c14(1.0, 1.0), 0.200_043_776_075_403, 1e-14);
}

#[test]
fn a_point_under_a_corner_howell_b3() {
    // An element parallel to a rectangle a by b at distance c, under its corner (Howell B-3).
    for (a, b, c) in [(1.0, 1.0, 1.0), (3.0, 0.2, 0.7), (1e3, 1e3, 1.0), (1.0, 2.0, 1e3)] {
        let rectangle = rectangle(c * Vec3::Z, b * Vec3::Y, a * Vec3::X);
        let (x, y): (f64, f64) = (a / c, b / c);
        let (rx, ry) = (1.0f64.hypot(x), 1.0f64.hypot(y));
        let exact = (x / rx * (y / rx).atan() + y / ry * (x / ry).atan()) / std::f64::consts::TAU;
        // Four terms, each at most 1/4 and exact to some ulp; far away they cancel, 1e-16 against 1e-7.
        assert_close(point_to_polygon::form_factor(Vec3::ZERO, Vec3::Z, &rectangle), exact, 1e-15);
    }
}

#[test]
fn triangles_with_common_edges_and_corners() {
    // No closed form is published. Two independent quadratures in extended precision agree on all digits given.
    let base: Triangle = [Vec3::ZERO, vec3(1.0, 0.0, 0.0), vec3(0.5, 1.0, 0.0)];
    let hinged = |degrees: f64| {
        let (sine, cosine) = degrees.to_radians().sin_cos();
        [base[1], base[0], vec3(0.5, cosine, sine)]
    };
    let mut contours = 0;
    let sliver = [Vec3::ZERO, vec3(1.0, 0.0, 0.0), vec3(0.5, 0.001, 0.0)];
    for (a, b, exact) in [
        (base, hinged(10.0), 0.847_137_928_118_461_2),
        (base, hinged(45.0), 0.498_974_959_551_085),
        (base, hinged(90.0), 0.215_074_168_155_030_53),
        (base, hinged(150.0), 0.023_563_222_142_173_004),
        (base, [Vec3::ZERO, vec3(-1.0, 0.0, 0.0), vec3(-0.5, 0.0, 1.0)], 0.012_741_091_323_115_055),
        (sliver, [vec3(1.0, 0.0, 0.0), Vec3::ZERO, vec3(0.5, 0.0, 1.0)], 0.499_552_743_770_283_36),
        (
            [Vec3::ZERO, vec3(1.0, 0.0, 0.0), vec3(0.3, 1.0, 0.0)],
            [vec3(0.2, 1.1, 0.4), vec3(0.9, 0.7, 1.3), vec3(-0.3, 0.9, 0.9)],
            0.068_896_174_226_765_99,
        ),
        (
            [Vec3::ZERO, vec3(2.0, 0.0, 0.0), vec3(0.0, 2.0, 0.0)],
            [vec3(0.2, -1.5, 0.9), vec3(-1.0, 0.3, -0.8), vec3(0.5, 0.5, 1.0)],
            0.125_035_699_593_015_78,
        ),
        (
            [Vec3::ZERO, vec3(1.0, 0.0, 0.0), vec3(0.3, 1.0, 0.0)],
            [vec3(0.1, 0.2, 1e4), vec3(0.2, 1.3, 1e4 + 0.3), vec3(1.4, 0.4, 1e4 - 0.2)],
            2.244_056_088_607_039_4e-9,
        ),
    ] {
        // The relative tolerance asked for.
        assert_close(f(&a, &b), exact, 1e-8 * exact);
        // Pairs that lie in front of each other and not far apart are the contour integral's: exact but for rounding, some
        // hundred terms of the size of the perimeters' product, a few times the area.
        let in_front = |s: &Triangle, t: &Triangle| t.iter().all(|v| Plane::of(s).distance(*v) > -1e-12);
        if in_front(&a, &b) && in_front(&b, &a) && exact > 1e-3 {
            assert_close(by(Kernel::Contour, &Shape::new(&a), &Shape::new(&b)) / area(&a), exact, 1e-13);
            contours += 1;
        }
    }
    assert_eq!(contours, 7);
}

/// A pair of triangles in one of several positions, randomly turned and moved; the name tells which.
fn random_pair(random: &Random, case: usize) -> (&'static str, Triangle, Triangle) {
    let p: Triangle = random.triangle(Vec3::ZERO, 1.0);
    let apex = || 1.5 * random.in_cube();
    let (name, b) = match case % 7 {
        0 => ("far", random.triangle(20.0 * p[0].cross(p[1]).normalize() + random.direction(), 1.0)),
        1 => ("middle", random.triangle(4.0 * p[0].cross(p[1]).normalize() + random.direction(), 1.0)),
        2 => ("near", random.triangle(1.2 * (p[1] - p[0]).cross(p[2] - p[0]).normalize(), 1.0)),
        3 => ("common edge", [p[1], p[0], apex()]),
        4 => ("common corner", [p[0], apex(), apex()]),
        5 => ("unequal", random.triangle((p[1] - p[0]).cross(p[2] - p[0]).normalize(), 0.03)),
        _ => ("anywhere", random.triangle(random.between(0.3, 3.0) * random.direction(), random.between(0.2, 2.0))),
    };
    let (rotation, shift) = (random.rotation(), random.in_cube());
    let place = |t: Triangle| t.map(|v| rotated(&rotation, v) + shift);
    // Turned to face each other when they do not.
    let (mut a, mut b) = (place(p), place(b));
    let centre = |t: &Triangle| (t[0] + t[1] + t[2]) / 3.0;
    if Plane::of(&a).distance(centre(&b)) < 0.0 {
        a.swap(1, 2);
    }
    if Plane::of(&b).distance(centre(&a)) < 0.0 {
        b.swap(1, 2);
    }
    (name, a, b)
}

const TOLERANCES: [f64; 6] = [0.3, 1e-2, 1e-3, 1e-4, 1e-6, 1e-8];

#[test]
fn every_tolerance_is_met() {
    let random = Random::new(31);
    let mut positive = 0;
    for case in 0..1400 {
        let (name, a, b) = random_pair(&random, case);
        let reference = g(&a, &b, 1e-8);
        positive += usize::from(reference > 0.0);
        for tolerance in TOLERANCES {
            let value = g(&a, &b, tolerance);
            assert!(
                (value - reference).abs() <= tolerance * reference,
                "{name}: {value:e} against {reference:e} at tolerance {tolerance:e}, {a:?} {b:?}"
            );
        }
    }
    assert!(positive > 1200, "only {positive} pairs see each other");
}

#[test]
fn the_reference_is_right_by_brute_force() {
    // Disjoint pairs cut into 256 x 256 pieces by hand and integrated with 3 x 3 points each: an independent method whose
    // error falls with the fourth power of the piece size. Pieces are 1/16 of triangles at least 0.3 apart.
    let quarter = |t: &Triangle| -> [Triangle; 4] {
        let [a, b, c] = *t;
        let [ab, bc, ca] = [0.5 * (a + b), 0.5 * (b + c), 0.5 * (c + a)];
        [[a, ab, ca], [ab, b, bc], [ca, bc, c], [ab, bc, ca]]
    };
    let pieces = |t: Triangle| (0..4).fold(vec![t], |list, _| list.iter().flat_map(quarter).collect::<Vec<_>>());
    for (a, b) in [
        ([Vec3::ZERO, Vec3::X, Vec3::Y], [vec3(0.1, 0.2, 0.3), vec3(0.4, 1.3, 0.6), vec3(1.4, 0.4, 0.5)]),
        ([Vec3::ZERO, Vec3::X, Vec3::Y], [vec3(2.0, 0.0, 0.5), vec3(1.5, 1.0, 1.0), vec3(1.6, 0.5, 3.0)]),
        ([Vec3::ZERO, Vec3::X, Vec3::Y], [vec3(-1.0, 0.0, 2.0), vec3(0.0, 0.1, 2.3), vec3(-1.0, 3.0, 2.1)]),
    ] {
        let mut b = b;
        if Plane::of(&b).distance(a[0]) < 0.0 {
            b.swap(1, 2);
        }
        let (pieces_a, pieces_b) = (pieces(a), pieces(b));
        let mut sum = 0.0;
        for s in pieces_a.iter().map(|t| Shape::new(t)) {
            for t in pieces_b.iter().map(|t| Shape::new(t)) {
                sum += by(Kernel::Area(TriangleRule::P6), &s, &t);
            }
        }
        let value = g(&a, &b, 1e-8);
        assert!(value > 1e-3, "the pair must face each other: {value}");
        assert_close(sum, value, 1e-8 * value);
    }
}

#[test]
fn the_three_kernels_agree_at_middle_distances() {
    let random = Random::new(32);
    let mut pairs = 0;
    while pairs < 300 {
        let a = random.triangle(Vec3::ZERO, 1.0);
        let mut b = random.triangle(random.between(20.0, 40.0) * Plane::of(&a).normal, 1.0);
        if Plane::of(&b).distance(a[0]) < 0.0 {
            b.swap(1, 2);
        }
        let in_front = |s: &Triangle, t: &Triangle| t.iter().all(|v| Plane::of(s).distance(*v) > 0.0);
        if !in_front(&a, &b) || !in_front(&b, &a) {
            continue;
        }
        pairs += 1;
        let (a, b) = (Shape::new(&a), Shape::new(&b));
        let by_area = by(Kernel::Area(TriangleRule::P12), &a, &b);
        let by_point = by(Kernel::Point(TriangleRule::P16), &a, &b);
        let by_contour = by(Kernel::Contour, &a, &b);
        // Size over distance is below 0.15: degree 6 leaves 0.15^8 = 3e-7 of its first term's size, some hundredths.
        assert_close(by_point, by_area, 1e-8 * by_area);
        // The contour sum cancels from the product of the perimeters, about 16 at (1 + 3 D/P) = 20 times the rounding.
        assert_close(by_contour, by_area, 1e-8 * by_area + 2.0 * f64::EPSILON * 20.0 * 16.0);
    }
}

#[test]
fn splitting_a_polygon_preserves_the_sum() {
    let random = Random::new(33);
    let mut positive = 0;
    for case in 0..300 {
        let (name, a, b) = random_pair(&random, case);
        let (s, t) = (random.between(0.2, 0.4), random.between(0.2, 0.4));
        let inside = a[0] + s * (a[1] - a[0]) + t * (a[2] - a[0]);
        let parts = [[a[0], a[1], inside], [a[1], a[2], inside], [a[2], a[0], inside]];
        for tolerance in [1e-3, 1e-8] {
            let whole = g(&a, &b, tolerance);
            let sum: f64 = parts.iter().map(|part| g(part, &b, tolerance)).sum();
            // Positive terms that each meet the tolerance: their sum meets it, and the whole does.
            assert!((sum - whole).abs() <= 2.0 * tolerance * whole, "{name}: {sum:e} against {whole:e}, {a:?} {b:?}");
            positive += usize::from(whole > 0.0);
        }
    }
    assert!(positive > 500);
}

#[test]
fn only_kernels_that_may_be_chosen_are_forced_and_every_pair_needs_a_place() {
    for kernel in [Kernel::Area(TriangleRule::P16), Kernel::Point(TriangleRule::P3)] {
        assert!(invalid(Accuracy::by(kernel)).contains(&kernel.name()));
    }
    // Polygons that touch: a point rule is far off, and still it is what has been asked for.
    let a = [Vec3::ZERO, Vec3::X, Vec3::Y];
    let b = [Vec3::ZERO, Vec3::Z, Vec3::X];
    let (a, b) = (Shape::new(&a), Shape::new(&b));
    assert!(by(Kernel::Point(TriangleRule::P7), &a, &b) != by(Kernel::Contour, &a, &b));
    let patches = [Patch::new([Vec3::ZERO, Vec3::X, Vec3::Y])];
    let accuracy = Accuracy::new(1e-3).unwrap();
    assert!(invalid(Batch::new().exchange_pairs(&patches, &patches, &[[0, 0]], &accuracy, &mut [])).contains("places"));
}

#[test]
fn a_batch_gives_the_bits_of_every_pair_alone_on_all_instructions_the_same_to_rounding() {
    let random = Random::new(38);
    let pairs: Vec<(&str, Triangle, Triangle)> = (0..1400).map(|case| random_pair(&random, case)).collect();
    let (a, b): (Vec<Patch>, Vec<Patch>) = pairs.iter().map(|(_, a, b)| (Patch::new(*a), Patch::new(*b))).unzip();
    let order: Vec<[u32; 2]> = (0..pairs.len() as u32).map(|k| [k, k]).collect();
    for tolerance in [1e-2, 1e-5, 1e-8] {
        let accuracy = Accuracy::new(tolerance).unwrap();
        let all = Instructions::available().into_iter().map(|instructions| {
            let mut out = vec![0.0; pairs.len()];
            Batch::with_instructions(instructions).exchange_pairs(&a, &b, &order, &accuracy, &mut out).unwrap();
            out
        });
        let all: Vec<Vec<f64>> = all.collect();
        let best = all.last().unwrap();
        for (k, (name, p, q)) in pairs.iter().enumerate() {
            // The other order, alone, as polygons: a different way through the code, the same numbers.
            assert_eq!(g(q, p, tolerance).to_bits(), best[k].to_bits(), "{name} at {tolerance:e}: {p:?} {q:?}");
            for other in &all {
                // Fused or not, the terms differ by some ulp, and they cancel as far as the tolerance allows at most.
                let rounding = 1e-11 * best[k] + 1e-14 * a[k].area.max(b[k].area);
                assert_close(other[k], best[k], rounding);
            }
        }
    }
}

#[test]
fn exchange_is_symmetric_bit_for_bit() {
    let random = Random::new(34);
    let mut positive = 0;
    for case in 0..700 {
        let (_, a, b) = random_pair(&random, case);
        for tolerance in TOLERANCES {
            let (ab, ba) = (g(&a, &b, tolerance), g(&b, &a, tolerance));
            assert_eq!(ab.to_bits(), ba.to_bits(), "{a:?} {b:?} at {tolerance:e}");
            positive += usize::from(ab > 0.0);
        }
    }
    assert!(positive > 3500);
    // Equal areas: the order is by the corners.
    let a = rectangle(Vec3::ZERO, Vec3::X, Vec3::Y);
    for b in [rectangle(Vec3::Z, Vec3::Y, Vec3::X), rectangle(Vec3::ZERO, Vec3::Y, Vec3::Z)] {
        assert_eq!(g(&a, &b, 1e-8).to_bits(), g(&b, &a, 1e-8).to_bits());
    }
}

#[test]
fn polygons_in_one_plane_or_turned_away_exchange_nothing() {
    let random = Random::new(35);
    for _ in 0..300 {
        let (rotation, size) = (random.rotation(), 10f64.powf(random.between(-6.0, 6.0)));
        let place = |v: Vec3| size * rotated(&rotation, v);
        let flat = || vec3(random.between(-1.0, 2.0), random.between(0.2, 1.0), 0.0);
        let [p, q] = [Vec3::ZERO, Vec3::X].map(place);
        let a = [p, q, place(flat())];
        let (mirror, lift) = (flat() * vec3(1.0, -1.0, 1.0), random.between(0.01, 2.0) * Vec3::Z);
        // Back to back, with a gap; front to back; one of them below the other's horizon.
        let turned = [q, p, place(mirror)].map(|v| v + place(lift));
        let back = [a[0], a[2], a[1]];
        for tolerance in [1e-2, 1e-8] {
            assert_eq!(g(&a, &turned, tolerance), 0.0, "both look up, one above the other's plane");
            assert_eq!(g(&back, &turned, tolerance), 0.0, "back to back");
            assert_eq!(g(&a, &a, tolerance), 0.0, "itself");
            assert_eq!(g(&a, &back, tolerance), 0.0, "its own back");
            let beside = [q, p, place(mirror)];
            assert_eq!(g(&a, &beside, tolerance), 0.0, "in one plane, with a common edge");
        }
        // In one plane and apart: the rounding of the coordinates tilts them by eps, light passes by eps^2.
        let apart = [q, p, place(mirror)].map(|v| v - place(0.3 * Vec3::Y));
        assert!(g(&a, &apart, 1e-8) <= 1e-28 * size * size);
    }
}

#[test]
fn form_factors_do_not_depend_on_the_unit_of_length() {
    let random = Random::new(36);
    for case in 0..140 {
        let (name, a, b) = random_pair(&random, case);
        for tolerance in [1e-2, 1e-4, 1e-8] {
            let scaled = |factor: f64| g(&a.map(|v| factor * v), &b.map(|v| factor * v), tolerance) / (factor * factor);
            let one = scaled(1.0);
            // A power of two changes no digit of anything, so the result has the same bits.
            for exponent in [-30, -7, 11, 30] {
                let value = scaled(2f64.powi(exponent));
                assert_eq!(value.to_bits(), one.to_bits(), "{name}, 2^{exponent}: {value:e} and {one:e}");
            }
            // Other factors round the corners: eps relative to coordinates of size up to 30, seen by kernels that are
            // themselves exact to the tolerance only.
            for factor in [1e-9, 1e-3, 1e3, 1e9] {
                assert_close(scaled(factor), one, (1e-11 + 2e-8) * one);
            }
        }
    }
}

#[test]
fn a_polygon_that_straddles_the_horizon_equals_its_front_half() {
    let b = rectangle(Vec3::ZERO, Vec3::Y, Vec3::Z);
    let from = |low: f64| rectangle(low * Vec3::X, (1.0 - low) * Vec3::X, Vec3::Y);
    let exact = howell_c14(1.0, 1.0);
    for low in [-1e-3, -1.0, -50.0] {
        for tolerance in TOLERANCES {
            assert_close(g(&from(low), &b, tolerance), exact, tolerance * exact);
        }
    }
    // Both straddle: halves below each other's horizon.
    let tall = rectangle(-3.0 * Vec3::Z, Vec3::Y, 4.0 * Vec3::Z);
    assert_close(g(&from(-2.0), &tall, 1e-8), exact, 1e-8 * exact);
    // The more of it comes before the horizon, the more it sees, from nothing to all.
    let sliding: Vec<f64> =
        (0..=20).map(|k| g(&rectangle((f64::from(k) / 20.0 - 1.0) * Vec3::X, Vec3::X, Vec3::Y), &b, 1e-8)).collect();
    assert_eq!(sliding[0], 0.0);
    assert!(sliding.windows(2).all(|w| w[0] < w[1]), "{sliding:?}");
    assert_close(sliding[20], exact, 1e-8 * exact);
}

#[test]
fn random_straddling_polygons_equal_their_front_parts() {
    let random = Random::new(37);
    let mut cut = 0;
    for _ in 0..500 {
        let (a, b) = (random.triangle(Vec3::ZERO, 1.0), random.triangle(0.5 * Vec3::X, 1.0));
        let (mut front_a, mut front_b) = (Vec::new(), Vec::new());
        clip_to_front(&a, &Plane::of(&b), &mut front_a);
        clip_to_front(&b, &Plane::of(&a), &mut front_b);
        let whole = g(&a, &b, 1e-8);
        if front_a.is_empty() || front_b.is_empty() {
            assert_eq!(whole, 0.0);
            continue;
        }
        cut += usize::from(front_a.len() != 3 || front_b.len() != 3);
        let parts = g(&front_a, &front_b, 1e-8);
        // Twice the tolerance, one for each; where triangles pierce each other the cut itself is rounded.
        assert_close(parts, whole, 2e-8 * whole + 1e-14);
    }
    assert!(cut > 100, "{cut} pairs were cut");
}

#[test]
fn the_sides_of_a_box_see_everything() {
    // A closed convex surface: what leaves one side arrives at the others. Sides as whole polygons, aspect 1 : 4 : 0.05.
    let (x, y, z) = (Vec3::X, 4.0 * Vec3::Y, 0.05 * Vec3::Z);
    let sides = [
        rectangle(Vec3::ZERO, x, y),
        rectangle(z, y, x),
        rectangle(Vec3::ZERO, y, z),
        rectangle(x, z, y),
        rectangle(Vec3::ZERO, z, x),
        rectangle(y, x, z),
    ];
    for (i, a) in sides.iter().enumerate() {
        let sum: f64 = sides.iter().enumerate().filter(|(j, _)| *j != i).map(|(_, b)| f(a, b)).sum();
        // Each factor is exact to 1e-8 of itself, so their sum is.
        assert_close(sum, 1.0, 1e-8);
    }
}

#[test]
fn accuracy_refuses_what_it_cannot_keep() {
    for tolerance in [0.0, -1.0, 1.0, 1e-11, f64::NAN, f64::INFINITY] {
        assert!(invalid(Accuracy::new(tolerance)).contains("is outside [1e-10, 1)"));
    }
    for tolerance in TOLERANCES {
        assert!(Accuracy::new(tolerance).is_ok());
    }
}

#[test]
fn the_kernel_of_two_points() {
    // cos 60 cos 60 / (pi 2^2), and nothing where either faces away.
    let up = vec3(0.0, 0.0, 1.0);
    let q = 2.0 * vec3(0.75f64.sqrt(), 0.0, 0.5);
    assert_close(kernel(Vec3::ZERO, up, q, -up), 0.25 / (4.0 * std::f64::consts::PI), 1e-16);
    assert_eq!(kernel(Vec3::ZERO, up, q, up), 0.0);
    assert_eq!(kernel(Vec3::ZERO, -up, q, -up), 0.0);
}

/// The visible fraction of two triangles face to face, mirror images of themselves in x = 0, behind what `blocker` adds.
fn fraction(blocker: Option<Mesh>, segments: u32, seed: u64) -> VisibleFraction {
    let lower = [vec3(-1.0, 0.0, 0.0), vec3(1.0, 0.0, 0.0), vec3(0.0, 1.0, 0.0)];
    let upper = [vec3(1.0, 0.0, 1.0), vec3(-1.0, 0.0, 1.0), vec3(0.0, 1.0, 1.0)];
    let mesh = Mesh::of_triangles(&[lower, upper]).and(&blocker.unwrap_or_default());
    let scene = mesh.scene();
    let end = |i: usize| End { patch: i as u32, triangle: scene.triangle(i), normal: scene.normals()[i] };
    visible_fraction(&Bvh::of_scene(&scene), &end(0), &end(1), segments, seed)
}

#[test]
fn the_visible_fraction_of_a_pair() {
    let sheet = |x: f64| Some(plate(vec3(x, -5.0, 0.5), 10.0 * Vec3::X, 10.0 * Vec3::Y, 1));
    let exact = |v: VisibleFraction| {
        // All 64 segments count, none of them more than a few others: the plates are as far apart as they are wide.
        assert!(v.standard_error == 0.0 && v.effective > 32.0 && v.effective <= 64.0, "{v:?}");
        v.value
    };
    assert_eq!(exact(fraction(None, 64, 0)), 1.0);
    assert_eq!(exact(fraction(sheet(-5.0), 64, 0)), 0.0, "a sheet that covers everything");
    assert_eq!(exact(fraction(sheet(1.1), 64, 0)), 1.0, "a sheet beside");
    // A sheet over x > 0 halfway up: mirroring swaps blocked and free segments, so exactly half is seen.
    let mut errors = Vec::new();
    for seed in 0..32 {
        let v = fraction(sheet(0.0), 1024, seed);
        assert!(v.standard_error > 0.0 && v.standard_error < 0.02, "{v:?}");
        errors.push((v.value - 0.5) / v.standard_error);
    }
    // Student's t with 3 degrees of freedom: |t| > 12.9 with probability 0.001 each, so 3 % for any of 32; and the median
    // of |t|, 0.76, is known to about 0.15 from 32 values.
    errors.iter_mut().for_each(|e| *e = e.abs());
    errors.sort_by(f64::total_cmp);
    assert!(errors[31] < 12.9 && (0.3..1.5).contains(&errors[16]), "{errors:?}");
}

#[test]
fn a_pair_that_no_segment_can_join_is_not_guessed() {
    // The plates turn their backs on each other: no kernel is positive, nothing can be learnt.
    let scene = two_plates(1).reversed().scene();
    let end = |i: usize| End { patch: i as u32, triangle: scene.triangle(i), normal: scene.normals()[i] };
    let v = visible_fraction(&Bvh::of_scene(&scene), &end(0), &end(2), 64, 0);
    assert_eq!((v.value, v.standard_error), (0.5, 0.5));
}
