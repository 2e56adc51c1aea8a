//! Quadrature against exact integrals, Sobol nets against their defining property, clipping and subdivision against area.

use std::collections::{HashMap, HashSet};

use radiosity::geometry::polygon::{self, Plane, area, area_vector, clip_to_front, defect};
use radiosity::geometry::quadrature::{GAUSS, MOST_GAUSS_POINTS, TrianglePoint, TriangleRule};
use radiosity::geometry::sampling::{DIMENSIONS, Sobol, point_in_triangle};
use radiosity::geometry::subdivision::{Subdivision, subdivide};
use radiosity::geometry::{Triangle, Vec3};
use radiosity::{Error, Progress};

use crate::common::{Mesh, PLENTY, Random, assert_close, box_in_box, cube, icosphere, invalid, plate, rotated, vec3};

const RULES: [TriangleRule; 5] =
    [TriangleRule::P3, TriangleRule::P6, TriangleRule::P7, TriangleRule::P12, TriangleRule::P16];

/// Sums of up to 100 positive terms below 1, from tables rounded to double: a few ulp each at most.
const ROUNDING: f64 = 16.0 * f64::EPSILON;

fn factorial(n: usize) -> f64 {
    (1..=n).map(|k| k as f64).product()
}

/// The largest error of a rule over the monomials x^i y^j with i + j = degree, on the triangle (0,0) (1,0) (0,1).
///
/// Exact: i! j! 2A / (i + j + 2)! (Stroud 1971, "Approximate Calculation of Multiple Integrals"), here divided by A.
fn worst_monomial(rule: TriangleRule, degree: usize) -> f64 {
    (0..=degree)
        .map(|i| {
            let j = degree - i;
            let mut sum = 0.0;
            for TrianglePoint { barycentric: [x, y, _], weight } in rule.points() {
                sum += weight * x.powi(i as i32) * y.powi(j as i32);
            }
            (sum - 2.0 * factorial(i) * factorial(j) / factorial(degree + 2)).abs()
        })
        .fold(0.0, f64::max)
}

#[test]
fn triangle_rules_are_exact_to_their_degree_and_no_further() {
    for rule in RULES {
        for degree in 0..=rule.degree() {
            let error = worst_monomial(rule, degree);
            assert!(error < ROUNDING, "{rule:?}, degree {degree}: error {error:e}");
        }
        // One degree further the error of the rule itself shows: far above rounding, or the loop above proves nothing.
        let error = worst_monomial(rule, rule.degree() + 1);
        assert!(error > 1e-7, "{rule:?} is better than it says: {error:e} at degree {}", rule.degree() + 1);
    }
}

#[test]
fn triangle_rules_have_the_points_they_promise_inside_with_positive_weights() {
    for rule in RULES {
        let mut points = 0;
        for TrianglePoint { barycentric: b, weight } in rule.points() {
            points += 1;
            assert!(*weight > 0.0 && b.iter().all(|x| *x > 0.0), "{rule:?}: {b:?} weighs {weight}");
            assert_close(b.iter().sum(), 1.0, ROUNDING);
        }
        assert_eq!(format!("P{points}"), format!("{rule:?}"));
    }
}

#[test]
fn polygon_quadrature_integrates_polynomials_over_a_square() {
    let square = [vec3(0.0, 0.0, 3.0), vec3(1.0, 0.0, 3.0), vec3(1.0, 1.0, 3.0), vec3(0.0, 1.0, 3.0)];
    for rule in RULES {
        let mut points = 0;
        for i in 0..=rule.degree() {
            let j = rule.degree() - i;
            let mut sum = 0.0;
            points = 0;
            rule.for_each_in_polygon(&square, |p, weight| {
                points += 1;
                sum += weight * p.x.powi(i as i32) * p.y.powi(j as i32);
            });
            assert_close(sum, 1.0 / ((i + 1) * (j + 1)) as f64, ROUNDING);
        }
        assert_eq!(points, 2 * rule.points().len(), "a fan of two triangles");
    }
}

#[test]
fn gauss_rules_are_exact_to_degree_2n_minus_1_and_no_further() {
    for n in 1..=MOST_GAUSS_POINTS {
        let integral = |degree: i32| GAUSS[n].iter().map(|(node, weight)| weight * node.powi(degree)).sum::<f64>();
        for degree in 0..2 * n as i32 {
            let exact = if degree % 2 == 0 { 2.0 / f64::from(degree + 1) } else { 0.0 };
            assert_close(integral(degree), exact, ROUNDING);
        }
        // The error at degree 2n is known in closed form: 2^(2n+1) (n!)^4 / ((2n+1) ((2n)!)^2) (Abramowitz & Stegun
        // 25.4.30 with f^(2n) = (2n)!). It falls below the rounding of the integral at n = 13.
        let size = 2.0 / (2 * n + 1) as f64;
        let expected = size * 4f64.powi(n as i32) * (factorial(n).powi(2) / factorial(2 * n)).powi(2);
        let error = size - integral(2 * n as i32);
        assert_close(error, expected, ROUNDING);
        assert!(n > 12 || error > 1e-9, "{n} points: {error:e}");
    }
}

/// How many of the points fall into each of the 2^a x 2^b boxes over two coordinates.
fn counts(points: &[[f64; DIMENSIONS]], dims: [usize; 2], a: u32, b: u32) -> Vec<usize> {
    let mut counts = vec![0; 1 << (a + b)];
    for p in points {
        let cell = |d: usize, bits: u32| (p[dims[d]] * f64::from(1u32 << bits)) as usize;
        counts[(cell(0, a) << b) + cell(1, b)] += 1;
    }
    counts
}

/// Whether every box of 2^t / 256 of the unit square, of any shape, holds 2^t of the 256 points: a (t, 8, 2)-net.
fn is_net(points: &[[f64; DIMENSIONS]], dims: [usize; 2], t: u32) -> bool {
    (0..=8 - t).all(|a| counts(points, dims, a, 8 - t - a).iter().all(|&count| count == 1 << t))
}

#[test]
fn sobol_points_are_nets() {
    for seed in 0..8 {
        let sobol = Sobol::new(seed);
        let points: Vec<_> = (0..256).map(|k| sobol.point(k)).collect();
        assert!(points.iter().flatten().all(|x| *x > 0.0 && *x < 1.0));
        // Coordinates 0 and 1 are a (0, 8, 2)-net: one point in every elementary box of area 1/256, the 16 x 16 grid and
        // all other shapes (Sobol 1967). Owen scrambling keeps t (Owen 1995), so the others have the t of the plain Sobol
        // points of Joe & Kuo 2008, worked out by a separate program on those of scipy.stats.qmc, and no less.
        let first =
            [([0, 1], 0), ([0, 2], 1), ([0, 3], 1), ([1, 2], 1), ([1, 3], 2), ([2, 3], 1), ([0, 4], 1), ([1, 5], 0)];
        let rest = [([4, 5], 3), ([2, 6], 2), ([5, 7], 2), ([6, 7], 2)];
        for (dims, t) in first.into_iter().chain(rest) {
            assert!(is_net(&points, dims, t), "seed {seed}: coordinates {dims:?} are no net of t = {t}");
            assert!(t == 0 || !is_net(&points, dims, t - 1), "seed {seed}: {dims:?} are other points than Joe & Kuo's");
        }
        // Each coordinate alone has one point in every 256th.
        for d in 0..DIMENSIONS {
            assert!(counts(&points, [d, d], 8, 0).iter().all(|&c| c == 1), "seed {seed}: coordinate {d}");
        }
    }
}

#[test]
fn sobol_seeds_are_different_and_unbiased_scrambles() {
    // 32-bit coordinates: that two of 1024 independent points agree in one of them has probability 2^-13 a coordinate.
    let firsts: HashSet<_> = (0..1024).map(|seed| Sobol::<4>::new(seed).point(0).map(f64::to_bits)).collect();
    assert_eq!(firsts.len(), 1024);
    // Over the seeds every single point is uniform. Chi-square over 64 cells, 63 degrees of freedom: outside 21 to 135 with
    // probability 1e-6, and 8 of them are looked at.
    for d in 0..DIMENSIONS {
        let mut cells = [0.0; 64];
        let coordinate = |seed| Sobol::<DIMENSIONS>::new(seed).point(77)[d];
        (0..4096).for_each(|seed| cells[(coordinate(seed) * 64.0) as usize] += 1.0);
        let chi2: f64 = cells.iter().map(|c: &f64| (c - 64.0).powi(2) / 64.0).sum();
        assert!((21.0..135.0).contains(&chi2), "coordinate {d}: chi-square {chi2}");
    }
}

#[test]
fn sobol_means_converge_faster_than_random() {
    let n = 1u32 << 14;
    let sobol = Sobol::<DIMENSIONS>::new(3);
    for d in 0..DIMENSIONS {
        // One point in each of n equal intervals: the mean is off by less than half an interval, whatever the scramble.
        let mean = (0..n).map(|k| sobol.point(k)[d]).sum::<f64>() / f64::from(n);
        assert_close(mean, 0.5, 0.5 / f64::from(n));
    }
    // RMS error of the integral of x0 x1 x2 x3 over 64 scrambles. Random points would gain 4 from 16 times as many; a
    // scrambled net gains up to 16^1.5 = 64 (Owen 1997). The ratio of two RMS of 64 values is known to about 12 %.
    let rms = |n: u32| {
        let squares = (0..64).map(|seed| {
            let sobol = Sobol::<4>::new(seed);
            let mean = (0..n).map(|k| sobol.point(k).iter().product::<f64>()).sum::<f64>() / f64::from(n);
            (mean - 1.0 / 16.0).powi(2)
        });
        (squares.sum::<f64>() / 64.0).sqrt()
    };
    let gain = rms(256) / rms(4096);
    assert!(gain > 16.0, "16 times the points gained {gain}");
}

#[test]
fn points_in_a_triangle_are_uniform() {
    // On (0,0) (1,0) (0,1) the coordinates are barycentric; E x = 1/3, E x^2 = 1/6, E xy = 1/12.
    let triangle: Triangle = [Vec3::ZERO, vec3(1.0, 0.0, 0.0), vec3(0.0, 1.0, 0.0)];
    let n = 1000;
    let mut moments = [0.0; 5];
    for k in 0..n * n {
        let at = |k: usize| (k as f64 + 0.5) / n as f64;
        let p = point_in_triangle(&triangle, at(k % n), at(k / n));
        assert!(p.x >= 0.0 && p.y >= 0.0 && p.x + p.y <= 1.0 + f64::EPSILON);
        for (m, value) in moments.iter_mut().zip([p.x, p.y, p.x * p.x, p.x * p.y, p.y * p.y]) {
            *m += value / (n * n) as f64;
        }
    }
    // The midpoint rule on sqrt(u), whose slope is infinite at 0, errs by 0.2 n^-1.5 = 6e-6.
    for (m, exact) in moments.iter().zip([1.0 / 3.0, 1.0 / 3.0, 1.0 / 6.0, 1.0 / 12.0, 1.0 / 6.0]) {
        assert_close(*m, exact, 1e-5);
    }
    // The map is affine in the corners: any other triangle is uniform too.
    let other = Random::new(1).triangle(vec3(5.0, -3.0, 2.0), 2.0);
    let p = point_in_triangle(&triangle, 0.3, 0.8);
    let q = other[0] + p.x * (other[1] - other[0]) + p.y * (other[2] - other[0]);
    assert!(point_in_triangle(&other, 0.3, 0.8).distance(q) < 1e-14);
}

#[test]
fn area_and_normal_of_polygons_in_closed_form() {
    let random = Random::new(2);
    for n in [3, 4, 5, 8, 64] {
        let (rotation, shift) = (random.rotation(), 10.0 * random.in_cube());
        let corners: Vec<Vec3> = (0..n)
            .map(|k| {
                let (y, x) = (std::f64::consts::TAU * f64::from(k) / f64::from(n)).sin_cos();
                shift + rotated(&rotation, vec3(x, y, 0.0))
            })
            .collect();
        // A regular n-gon in the unit circle has the area n/2 sin(2 pi / n). Coordinates of size 10 have ulp of 2e-15.
        let exact = 0.5 * f64::from(n) * (std::f64::consts::TAU / f64::from(n)).sin();
        assert_close(area(&corners), exact, 1e-13);
        let plane = Plane::of(&corners);
        assert!(plane.normal.distance(rotation[2]) < 1e-13, "{n} corners: the normal");
        assert!(corners.iter().all(|v| plane.distance(*v).abs() < 1e-13));
        assert_close(plane.distance(corners[0] + 2.5 * rotation[2]), 2.5, 1e-13);
        assert!(polygon::centre(&corners).distance(shift) < 1e-13);
    }
}

#[test]
fn area_far_from_the_origin_loses_no_digits() {
    // 2^20 + k/1024 is exact in f64, so the area is too.
    let far = Vec3::splat(1_048_576.0);
    let triangle = [far, far + vec3(1.0 / 1024.0, 0.0, 0.0), far + vec3(0.0, 1.0 / 1024.0, 0.0)];
    assert_eq!(area(&triangle), 0.5 / (1024.0 * 1024.0));
}

/// The part of `corners` before the plane.
fn clipped(corners: &[Vec3], plane: &Plane) -> Vec<Vec3> {
    let mut out = vec![Vec3::NAN; 3];
    clip_to_front(corners, plane, &mut out);
    out
}

const SQUARE: [Vec3; 4] =
    [Vec3::new(-1.0, -1.0, 0.0), Vec3::new(1.0, -1.0, 0.0), Vec3::new(1.0, 1.0, 0.0), Vec3::new(-1.0, 1.0, 0.0)];

fn facing(normal: Vec3, point: Vec3) -> Plane {
    Plane { normal: normal.normalize(), point }
}

#[test]
fn clipping_cuts_where_the_plane_is() {
    let half = clipped(&SQUARE, &facing(Vec3::X, vec3(0.25, 0.0, 0.0)));
    assert_eq!(area_vector(&half), vec3(0.0, 0.0, 1.5));
    assert!(half.iter().all(|v| v.x >= 0.25));
    // A corner cut off: 4 minus a right triangle of legs 1/2, up to the rounding of the normal.
    let cut = clipped(&SQUARE, &facing(vec3(-1.0, -1.0, 0.0), vec3(1.0, 0.5, 0.0)));
    assert_eq!(cut.len(), 5);
    assert_close(area(&cut), 4.0 - 0.125, 1e-15);
    // The diagonal passes through two corners: they stay, bit for bit, and no new ones appear.
    assert_eq!(clipped(&SQUARE, &facing(vec3(1.0, -1.0, 0.0), Vec3::ZERO)), [SQUARE[0], SQUARE[1], SQUARE[2]]);
}

#[test]
fn clipping_splits_the_area() {
    let random = Random::new(3);
    let mut cuts = 0;
    for _ in 0..2000 {
        let corners = random.triangle(random_shift(1.0), 1.0);
        let plane = facing(random.direction(), 0.5 * random.in_cube());
        let (front, back) = (clipped(&corners, &plane), clipped(&corners, &facing(-plane.normal, plane.point)));
        cuts += usize::from(!front.is_empty() && !back.is_empty());
        let total = area(&front) + area(&back);
        // Corners of size 2 move by an ulp: 4e-16 times a perimeter of up to 7.
        assert_close(total, area(&corners), 1e-14);
        assert!(front.iter().all(|v| plane.distance(*v) > -1e-15));
        assert!(area_vector(&front).dot(area_vector(&corners)) >= 0.0, "the order of the corners has turned");
    }
    assert!(cuts > 500, "only {cuts} of 2000 triangles met the plane");
}

/// A fixed point of the size given; spreads cases away from the origin.
fn random_shift(size: f64) -> Vec3 {
    size * vec3(0.31, -0.47, 0.22)
}

#[test]
fn clipping_leaves_alone_what_only_touches_and_drops_what_lies_behind() {
    let in_front = |normal: Vec3, x: f64| clipped(&SQUARE, &facing(normal, vec3(x, 0.0, 0.0)));
    assert_eq!(in_front(Vec3::X, -1.0), SQUARE, "an edge in the plane, the rest in front");
    assert_eq!(in_front(Vec3::X, -3.0), SQUARE, "clearly in front");
    assert_eq!(in_front(vec3(1.0, 1.0, 0.0), -2.0), SQUARE, "a corner in the plane, the rest in front");
    assert!(in_front(-Vec3::X, -1.0).is_empty(), "an edge in the plane, the rest behind");
    assert!(in_front(-vec3(1.0, 1.0, 0.0), -2.0).is_empty(), "a corner in the plane, the rest behind");
    assert!(in_front(Vec3::X, 3.0).is_empty(), "clearly behind");
    assert!(clipped(&SQUARE, &facing(Vec3::Z, Vec3::ZERO)).is_empty(), "in the plane");
}

#[test]
fn polygons_that_share_an_edge_are_not_cut_by_rounding() {
    let random = Random::new(4);
    for case in 0..2000 {
        let (rotation, size) = (random.rotation(), 10f64.powf(random.between(-6.0, 6.0)));
        let place = |v: Vec3| size * rotated(&rotation, v);
        let [p, q] = [0.0, 1.0].map(|x| place(vec3(x, 0.0, 0.0)));
        // From 0.1 to 179.9 degrees apart: everything but flat.
        let (sine, cosine) = random.between(0.1, 179.9).to_radians().sin_cos();
        let a = [p, q, place(vec3(random.between(-1.0, 2.0), 1.0, 0.0))];
        let b = [q, p, place(vec3(random.between(-1.0, 2.0), cosine, sine))];
        assert_eq!(clipped(&b, &Plane::of(&a)), b, "case {case}");
        assert_eq!(clipped(&a, &Plane::of(&b)), a, "case {case}");
    }
}

#[test]
fn defects_are_told() {
    let says = |corners: &[Vec3], what: &str| {
        let text = defect(corners).expect(what);
        assert!(text.contains(what), "\"{text}\" does not say \"{what}\"");
    };
    says(&[], "has 0 vertices");
    says(&SQUARE[..2], "has 2 vertices");
    says(&[Vec3::ZERO, Vec3::X, vec3(0.0, f64::NAN, 0.0)], "vertex 2");
    says(&[Vec3::ZERO, vec3(f64::INFINITY, 0.0, 0.0), Vec3::Y], "vertex 1");
    says(&[Vec3::ZERO, Vec3::X, 2.0 * Vec3::X], "zero area");
    says(&[Vec3::Y, Vec3::Y, Vec3::X], "zero area");
    says(&[SQUARE[0], SQUARE[1], SQUARE[2] + 0.01 * Vec3::Z, SQUARE[3]], "is not planar");
    // A dart: corner 2 points inwards.
    says(&[SQUARE[0], SQUARE[1], vec3(-0.5, -0.5, 0.0), SQUARE[3]], "is not convex at vertex 2");
    // A bow tie of unequal loops.
    says(&[vec3(-1.0, -1.0, 0.0), vec3(1.0, -1.0, 0.0), vec3(-0.5, 1.0, 0.0), vec3(0.9, 1.0, 0.0)], "is not convex");
    let circle = |n: u32| -> Vec<Vec3> {
        (0..n)
            .map(|k| std::f64::consts::TAU * f64::from(k) / f64::from(n))
            .map(|a| vec3(a.cos(), a.sin(), 0.0))
            .collect()
    };
    says(&circle(65), "at most 64");
    assert_eq!(defect(&circle(64)), None);
}

#[test]
fn a_star_is_not_convex() {
    let star: Vec<Vec3> =
        (0..5).map(|k| 0.8 * std::f64::consts::PI * f64::from(k)).map(|a| vec3(a.cos(), a.sin(), 0.0)).collect();
    assert!(defect(&star).is_some_and(|text| text.contains("is not convex")));
}

#[test]
fn good_polygons_have_no_defect_wherever_they_are() {
    let random = Random::new(5);
    for _ in 0..500 {
        let (rotation, size) = (random.rotation(), 10f64.powf(random.between(-9.0, 9.0)));
        // Up to 1e6 sizes away: there the coordinates themselves are rounded to 1e-10 of the size.
        let shift = 10f64.powf(random.between(0.0, 6.0)) * random.in_cube();
        let placed = SQUARE.map(|v| size * (shift + rotated(&rotation, v)));
        assert_eq!(defect(&placed), None, "{placed:?}");
        let [a, b, c, d] = placed;
        assert_eq!(defect(&[d, c, b, a]), None, "clockwise is a matter of the front, not of soundness");
    }
    // A corner in the middle of an edge is harmless.
    assert_eq!(defect(&[SQUARE[0], vec3(0.0, -1.0, 0.0), SQUARE[1], SQUARE[2], SQUARE[3]]), None);
}

fn subdivided(mesh: &Mesh, max_edge: f64) -> Subdivision {
    subdivide(&mesh.vertices, &mesh.indices(), max_edge, PLENTY, &Progress::default()).unwrap()
}

fn corners(vertices: &[Vec3], face: &[u32; 3]) -> Triangle {
    face.map(|v| vertices[v as usize])
}

/// Triangles of every shape, without common corners.
fn soup() -> Mesh {
    let random = Random::new(6);
    let triangles: Vec<Triangle> = (0..50).map(|_| random.triangle(random_shift(3.0), 1.0)).collect();
    Mesh::of_triangles(&triangles)
}

#[test]
fn subdivision_keeps_area_orientation_and_parents() {
    let sliver = Mesh::of_triangles(&[[Vec3::ZERO, vec3(1.0, 0.0, 0.0), vec3(0.5, 1e-3, 0.0)]]);
    for (name, mesh, max_edge) in [
        ("cube", cube(1), 0.3),
        ("icosphere", icosphere(1), 0.2),
        ("box in box", box_in_box(2), 0.26),
        ("soup", soup(), 0.25),
        ("sliver", sliver, 0.1),
    ] {
        let fine = subdivided(&mesh, max_edge);
        let coarse_faces = mesh.indices();
        assert!(fine.faces.len() > mesh.faces.len(), "{name}: nothing was divided");
        assert_eq!(fine.vertices[..mesh.vertices.len()], mesh.vertices, "{name}: the old corners come first");
        assert_eq!(fine.parent.len(), fine.faces.len());
        assert!(fine.parent.is_sorted(), "{name}: pieces of one face lie together");
        let mut areas = vec![0.0; coarse_faces.len()];
        for (face, &parent) in fine.faces.iter().zip(&fine.parent) {
            let (piece, whole) =
                (corners(&fine.vertices, face), corners(&mesh.vertices, &coarse_faces[parent as usize]));
            for k in 0..3 {
                assert!(piece[k].distance(piece[(k + 1) % 3]) <= max_edge, "{name}: an edge is too long");
            }
            areas[parent as usize] += area(&piece);
            // A sliver's normal is known to eps / 1e-3 only, and halving rounds the midpoints: 1e-11 covers both.
            let plane = Plane::of(&whole);
            assert!(Plane::of(&piece).normal.distance(plane.normal) < 1e-11, "{name}: a piece has turned");
            let centroid = polygon::centre(&piece);
            assert!(plane.distance(centroid).abs() < 1e-14, "{name}: a piece has left its plane");
            for k in 0..3 {
                let side = plane.normal.cross(whole[(k + 1) % 3] - whole[k]);
                assert!(side.dot(centroid - whole[k]) > 0.0, "{name}: a piece lies outside its parent");
            }
        }
        for (i, face) in coarse_faces.iter().enumerate() {
            // A few hundred pieces, each exact to some ulp of a coordinate of size 3 times its perimeter.
            assert_close(areas[i], area(&corners(&mesh.vertices, face)), 1e-13);
        }
    }
}

/// How often each edge occurs in each direction, corners compared by position.
fn edge_uses(mesh: &Subdivision) -> HashMap<[[u64; 3]; 2], usize> {
    let mut uses = HashMap::new();
    for face in &mesh.faces {
        for k in 0..3 {
            let key = [face[k], face[(k + 1) % 3]].map(|v| mesh.vertices[v as usize].to_array().map(f64::to_bits));
            *uses.entry(key).or_default() += 1;
        }
    }
    uses
}

#[test]
fn subdivision_of_a_closed_mesh_is_closed() {
    // Stretched, so that triangles with one, two and three long edges all occur.
    let stretched = |mesh: Mesh| mesh.map(|v| v * vec3(1.0, 1.7, 3.1));
    for (mesh, max_edge) in [
        (stretched(cube(1)), 0.4),
        (stretched(icosphere(2)), 0.3),
        (stretched(box_in_box(3)), 0.35),
        (icosphere(0), 0.9),
    ] {
        let fine = subdivided(&mesh, max_edge);
        let uses = edge_uses(&fine);
        assert!(uses.len() > 3 * mesh.faces.len());
        for (&[a, b], &count) in &uses {
            assert_eq!(count, 1, "an edge is used twice in one direction");
            assert!(uses.contains_key(&[b, a]), "an edge has no partner: a crack or a T-junction");
        }
    }
}

#[test]
fn triangles_with_one_two_three_long_edges_become_two_three_four() {
    // Longest edges first; the limit 1 leaves every piece short enough at once.
    for (lengths, pieces) in [([0.9, 0.9, 0.9], 1), ([1.1, 0.9, 0.9], 2), ([1.1, 1.1, 0.9], 3), ([1.1, 1.1, 1.1], 4)] {
        let [a, b, c]: [f64; 3] = lengths;
        let x = (a * a + c * c - b * b) / (2.0 * a);
        let triangle = [Vec3::ZERO, vec3(a, 0.0, 0.0), vec3(x, (c * c - x * x).sqrt(), 0.0)];
        for turn in 0..3 {
            let turned = [0, 1, 2].map(|k| triangle[(k + turn) % 3]);
            let fine = subdivided(&Mesh::of_triangles(&[turned]), 1.0);
            assert_eq!(fine.faces.len(), pieces, "edges {lengths:?}, turned by {turn}");
        }
    }
}

#[test]
fn subdivision_that_has_nothing_to_do_changes_nothing() {
    let mesh = cube(2);
    let fine = subdivided(&mesh, 10.0);
    assert_eq!((fine.vertices, fine.faces), (mesh.vertices.clone(), mesh.indices()));
    assert_eq!(fine.parent, (0..mesh.faces.len() as u32).collect::<Vec<_>>());
    // An edge of exactly the length asked for is not longer than asked for.
    assert_eq!(subdivided(&plate(Vec3::ZERO, Vec3::X, Vec3::Y, 1), 2f64.sqrt()).faces.len(), 2);
}

#[test]
fn subdivision_refuses_lengths_that_are_none() {
    let mesh = cube(1);
    for max_edge in [0.0, -1.0, f64::NAN, f64::INFINITY] {
        let text = invalid(subdivide(&mesh.vertices, &mesh.indices(), max_edge, PLENTY, &Progress::default()));
        assert!(text.contains(&format!("max_edge {max_edge}")), "{text}");
    }
}

#[test]
fn subdivision_refuses_what_does_not_fit_before_it_starts() {
    let mesh = cube(1);
    let progress = Progress::default();
    let divide = |max_edge: f64, memory: u64| subdivide(&mesh.vertices, &mesh.indices(), max_edge, memory, &progress);
    match divide(1e-6, 1 << 20) {
        Err(Error::Memory { needed, available, .. }) => assert!(needed > available && available == 1 << 20),
        other => panic!("{:?}", other.map(|fine| fine.faces.len())),
    }
    // Some thousand faces were made on the way, not the 10^13 that were asked for.
    assert!(progress.get().0 < 100_000);
    assert!(divide(0.3, 1 << 20).is_ok());
    // Halving ends where coordinates of size 1e6 are 1e-10 apart.
    let far: Vec<Vec3> = mesh.vertices.iter().map(|v| 1e-8 * *v + Vec3::splat(1e6)).collect();
    let text = invalid(subdivide(&far, &mesh.indices(), 1e-11, PLENTY, &progress));
    assert!(text.contains("below the rounding"), "{text}");
    progress.stop();
    assert!(matches!(divide(0.3, PLENTY), Err(Error::Interrupted)));
}
