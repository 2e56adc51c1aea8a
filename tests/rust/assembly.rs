//! The dense operator: conservation in closed scenes, occlusion against an exact value, the same bits every time, and an
//! error bar that means what it says.

use std::sync::Arc;
use std::time::Duration;

use radiosity::assembly::balance::{reciprocity_error, remainder};
use radiosity::assembly::matrix::{DenseMatrix, SparseMatrix};
use radiosity::assembly::{Dense, DenseOptions, FormFactors};
use radiosity::geometry::Vec3;
use radiosity::geometry::quadrature::GAUSS;
use radiosity::scene::{Scene, Sides};
use radiosity::{Error, Progress};

use crate::common::{
    Mesh, PLENTY, Random, assert_close, box_in_box, cube, dense, icosphere, invalid, on_threads, plate, stack_in_box,
    table, two_plates, vec3,
};

fn worst_remainder(f: &Dense) -> f64 {
    remainder(f).iter().map(|r| r.abs()).fold(0.0, f64::max)
}

#[test]
fn row_sums_of_a_closed_convex_scene_are_one() {
    for (name, scene) in [("cube", cube(3).scene()), ("sphere", icosphere(1).reversed().scene())] {
        for tolerance in [1e-1, 1e-3, 1e-6, 1e-8] {
            let f = dense(&scene, tolerance, 0);
            // What was asked for: sum over j of |dF_ij| <= tolerance.
            let worst = worst_remainder(&f);
            assert!(worst <= tolerance, "{name} at {tolerance:e}: {worst:e}");
            assert!(f.error_estimate() <= tolerance, "{name}: {}", f.error_estimate());
            // Nothing can stand between two patches of a convex scene, so nothing is sampled.
            assert_eq!(f.segments(), 0, "{name}");
            assert!(f.standard_error(&vec![1.0; scene.len()], 1).is_none());
            assert!(f.sampling_error(&vec![1.0; scene.len()], 1, 0).is_none());
            assert!(f.kernel_error() <= tolerance && f.kernel_error() > 0.0);
        }
    }
}

#[test]
fn looser_tolerances_are_not_tight_by_accident() {
    // Were the cheap kernels exact, the test above would say nothing about the tolerance.
    let scene = cube(3).scene();
    let [loose, tight] = [1e-1, 1e-6].map(|tolerance| worst_remainder(&dense(&scene, tolerance, 0)));
    assert!(loose > 100.0 * tight, "{loose:e} at 1e-1, {tight:e} at 1e-6");
}

#[test]
fn row_sums_of_a_closed_scene_with_something_inside_are_one() {
    // By shadows, the same for every seed; and by segments.
    for (scene, tolerance, seed) in [
        (box_in_box(3).scene(), 3e-2, 0),
        (box_in_box(3).scene(), 3e-3, 0),
        (box_in_box(3).scene(), 1e-4, 0),
        (stack_in_box(2).scene(), 3e-2, 1),
        (stack_in_box(2).scene(), 1e-2, 2),
    ] {
        {
            let f = dense(&scene, tolerance, seed);
            assert_eq!(f.segments() > 0, scene.len() == 88);
            // The budget was met. It adds the errors of a row's pairs, which mostly cancel, so that even the worst of 120
            // rows stays below their sum.
            assert!(f.error_estimate() <= tolerance, "{}", f.error_estimate());
            let worst = worst_remainder(&f);
            assert!(
                worst <= f.error_estimate(),
                "tolerance {tolerance}, seed {seed}: {worst} of {}",
                f.error_estimate()
            );
        }
    }
}

#[test]
fn reciprocity_is_exact_and_entries_are_fractions() {
    let scene = box_in_box(2).scene();
    let f = dense(&scene, 1e-2, 0);
    // F_ij and F_ji are one number divided by two areas: one rounding each.
    assert!(reciprocity_error(&f).unwrap() <= 2.0 * f64::EPSILON);
    let n = scene.len();
    let table = table(&f);
    for i in 0..n {
        assert_eq!(table[i * n + i], 0.0, "a flat patch does not see itself");
        for j in 0..n {
            assert!((0.0..=1.0).contains(&table[i * n + j]));
            let (ij, ji) = (f.areas().unwrap()[i] * table[i * n + j], f.areas().unwrap()[j] * table[j * n + i]);
            assert_close(ij, ji, 2.0 * f64::EPSILON * ij);
        }
    }
    assert_eq!(f.areas().unwrap(), scene.areas());
    assert_eq!(f.len(), n);
}

/// F between the squares z = 0 and z = 1 with the obstacle [0.1, 0.6]^2 at z = 1/2, patch by patch, added up.
fn partly_hidden(tolerance: f64) -> f64 {
    let obstacle = plate(vec3(0.1, 0.1, 0.5), 0.5 * Vec3::X, 0.5 * Vec3::Y, 1);
    let scene = two_plates(1).and(&obstacle).scene();
    let f = dense(&scene, tolerance, 0);
    assert!(f.segments() == 0 && f.error_estimate() <= tolerance);
    let (table, n) = (table(&f), scene.len());
    (0..2).flat_map(|i| (2..4).map(move |j| (i, j))).map(|(i, j)| scene.areas()[i] * table[i * n + j]).sum()
}

/// The same by quadrature: what a point of the lower square sees of the upper one, less the shadow that the obstacle casts
/// from there, both by the closed form of a point parallel to a rectangle (Howell B-3).
fn partly_hidden_exactly() -> f64 {
    // The rectangle [0, u] x [0, v] at height 1 above the origin, odd in u and v.
    let corner = |u: f64, v: f64| {
        let (ru, rv) = (1.0f64.hypot(u), 1.0f64.hypot(v));
        (u / ru * (v / ru).atan() + v / rv * (u / rv).atan()) / std::f64::consts::TAU
    };
    let rectangle =
        |[u0, u1]: [f64; 2], [v0, v1]: [f64; 2]| corner(u1, v1) - corner(u0, v1) - corner(u1, v0) + corner(u0, v0);
    // Seen from x, relative to x: the upper square, and the obstacle thrown to twice its distance, clipped to the square.
    let square = |x: f64| [-x, 1.0 - x];
    let shadow = |x: f64| [(0.2 - 2.0 * x).max(-x), (1.2 - 2.0 * x).min(1.0 - x)];
    // The shadow's border leaves the square at x = 0.2: Gauss on either side of it.
    let nodes: Vec<(f64, f64)> = [(0.0, 0.2), (0.2, 1.0)]
        .iter()
        .flat_map(|&(low, high)| {
            let (middle, half) = (0.5 * (low + high), 0.5 * (high - low));
            GAUSS[20].iter().map(move |(x, w)| (middle + half * x, half * w))
        })
        .collect();
    let seen = |x: f64, y: f64| rectangle(square(x), square(y)) - rectangle(shadow(x), shadow(y));
    nodes.iter().map(|&(x, wx)| nodes.iter().map(|&(y, wy)| wx * wy * seen(x, y)).sum::<f64>()).sum()
}

#[test]
fn partial_occlusion_against_its_exact_value() {
    // The 10-point rule on an integrand that is smooth for a distance of 1 around pieces of 0.8: 1e-14. The digits are
    // those of a third calculation, by two other partitions of the domain.
    let exact = partly_hidden_exactly();
    assert_close(exact, 0.119_682_831_109_198, 1e-14);
    for tolerance in [1e-2, 1e-3, 1e-4, 1e-5] {
        // The squares see nothing but each other and the obstacle: the row error bounds this sum.
        assert_close(partly_hidden(tolerance), exact, tolerance);
    }
}

#[test]
fn what_is_hidden_entirely_receives_nothing() {
    let wall = plate(vec3(-4.0, -4.0, 0.5), 9.0 * Vec3::X, 9.0 * Vec3::Y, 2);
    let scene = two_plates(2).and(&wall).scene();
    let (table, n) = (table(&dense(&scene, 1e-3, 0)), scene.len());
    for (i, j) in (0..8).flat_map(|i| (8..16).map(move |j| (i, j))) {
        assert_eq!(table[i * n + j], 0.0);
    }
    // The upper plate looks down on the wall, whose front is up.
    assert!((8..16).all(|j| table[j * n + 16..(j + 1) * n].iter().sum::<f64>() > 0.5));
}

#[test]
fn segments_that_all_agree_are_not_taken_for_certain() {
    // Nine walls hide the plates entirely, more than shadows are drawn of. Of m segments that are all blocked the hidden part
    // may still miss 1 / (m + 2) (Laplace's rule of succession), so a row that sees F without them needs m = F / tolerance.
    let wall = |k: usize| plate(vec3(-4.0, -4.0, 0.1 * k as f64), 9.0 * Vec3::X, 9.0 * Vec3::Y, 1);
    let scene = (1..10).fold(two_plates(1), |mesh, k| mesh.and(&wall(k))).scene();
    let tolerance = 1e-3;
    let f = dense(&scene, tolerance, 0);
    assert!(f.error_estimate() > f.kernel_error() && f.error_estimate() <= tolerance);
    // Four pairs of triangles, and 0.1998 (Howell C-11) between the plates.
    assert!(f.segments() as f64 > 4.0 * 0.1998 / tolerance, "{} segments", f.segments());
}

#[test]
fn bits_do_not_depend_on_the_number_of_threads() {
    let scene = stack_in_box(1).scene();
    let n = scene.len();
    let random = Random::new(41);
    let x: Vec<f64> = (0..3 * n).map(|_| random.uniform()).collect();
    let everything = |threads: usize| {
        on_threads(threads, || {
            let f = dense(&scene, 1e-2, 5);
            let mut image = vec![0.0; 3 * n];
            f.apply(&x, 3, &mut image);
            let numbers = [table(&f), image, f.row_sums(), f.standard_error(&x, 3).unwrap(), vec![f.error_estimate()]];
            (numbers.concat().iter().map(|v| v.to_bits()).collect::<Vec<_>>(), f.segments())
        })
    };
    let one = everything(1);
    assert!(one.1 > 0);
    assert_eq!(everything(1), one, "again");
    assert_eq!(everything(2), one, "2 threads");
    assert_eq!(everything(7), one, "7 threads");
    let other = dense(&scene, 1e-2, 6);
    assert_ne!(table(&other), table(&dense(&scene, 1e-2, 5)), "another seed, other segments");
}

/// All ways to multiply by F against the plain sum over the table.
fn assert_consistent(f: &dyn FormFactors, table: &[f64]) {
    let (n, bands) = (f.len(), 3);
    assert_eq!(table.len(), n * n);
    let random = Random::new(42);
    let x: Vec<f64> = (0..n * bands).map(|_| random.uniform()).collect();
    // Sums of at most 200 positive terms in another order: 200 eps of a result below 1.
    let tolerance = 200.0 * f64::EPSILON;
    let mut applied = vec![f64::NAN; n * bands];
    f.apply(&x, bands, &mut applied);
    let mut row = vec![f64::NAN; n];
    let sums = f.row_sums();
    for i in 0..n {
        let mut gathered = [f64::NAN; 3];
        f.gather(i, &x, &mut gathered);
        f.row(i, &mut row);
        let mut column = vec![1.0; n * bands];
        f.shoot(i, &[1.0, 0.5, 0.0], &mut column);
        for (j, (entry, shot)) in row.iter().zip(column.chunks_exact(bands)).enumerate() {
            assert_close(*entry, table[i * n + j], f64::EPSILON);
            // Shooting adds to what is there.
            let f_ji = table[j * n + i];
            (0..3).for_each(|b| assert_close(shot[b], 1.0 + [1.0, 0.5, 0.0][b] * f_ji, 2.0 * f64::EPSILON));
        }
        for b in 0..bands {
            let plain: f64 = (0..n).map(|j| table[i * n + j] * x[j * bands + b]).sum();
            assert_close(gathered[b], plain, tolerance);
            assert_close(applied[i * bands + b], plain, tolerance);
        }
        assert_close(sums[i], table[i * n..(i + 1) * n].iter().sum(), tolerance);
    }
}

#[test]
fn apply_gather_shoot_and_row_agree_for_every_kind_of_operator() {
    let open = cube(2).and(&plate(vec3(0.3, 0.3, 0.5), 0.3 * Vec3::X, 0.2 * Vec3::Y, 1));
    let f = dense(&open.scene(), 1e-2, 0);
    let (table, n) = (table(&f), f.len());
    assert!(table.iter().any(|v| *v > 0.01) && table.contains(&0.0));
    assert_consistent(&f, &table);
    let matrix = DenseMatrix::new(n, table.clone()).unwrap();
    assert_consistent(&matrix, &table);
    // Only what is not zero; every third entry in two halves, as CSR allows.
    let (mut start, mut index, mut value) = (vec![0], Vec::new(), Vec::new());
    for row in table.chunks_exact(n) {
        for (j, &v) in row.iter().enumerate().filter(|(_, v)| **v != 0.0) {
            let parts = if j % 3 == 0 { 2 } else { 1 };
            index.resize(index.len() + parts, j as u32);
            value.resize(value.len() + parts, v / parts as f64);
        }
        start.push(index.len());
    }
    assert!(index.len() > start.len() && value.len() < 4 * n * n / 3, "zeros were left out");
    let sparse = SparseMatrix::new(start, index, value).unwrap();
    assert_consistent(&sparse, &table);
    for f in [&matrix as &dyn FormFactors, &sparse] {
        assert!(f.areas().is_none() && f.standard_error(&vec![1.0; n], 1).is_none() && !f.is_empty());
        assert_eq!(reciprocity_error(f), None);
    }
    assert_eq!(matrix.nbytes(), 8 * n * n);
}

#[test]
fn matrices_that_are_none_are_refused() {
    let not_fitting = "do not describe a square matrix";
    let csr = |start: &[usize], index: &[u32], value: &[f64]| {
        invalid(SparseMatrix::new(start.to_vec(), index.to_vec(), value.to_vec()))
    };
    assert!(invalid(DenseMatrix::new(2, vec![0.0; 3])).contains("3 values do not make an 2 x 2 matrix"));
    let text = invalid(DenseMatrix::new(2, vec![0.0, -0.5, f64::NAN, 0.1]));
    assert!(text.contains("F[0, 1] = -0.5") && text.contains("F[1, 0] = NaN"), "{text}");
    assert!(csr(&[0, 1, 2], &[0, 2], &[0.1, 0.1]).contains(not_fitting), "column 2 of 2");
    assert!(csr(&[0, 2, 1], &[0, 1], &[0.1, 0.1]).contains(not_fitting), "rows run backwards");
    assert!(csr(&[0, 1, 3], &[0, 1], &[0.1, 0.1]).contains(not_fitting), "rows end beyond the entries");
    assert!(csr(&[1, 1, 2], &[0, 1], &[0.1, 0.1]).contains(not_fitting), "rows do not start at 0");
    assert!(csr(&[0, 1, 2], &[0, 1], &[0.1]).contains(not_fitting), "a value is missing");
    assert!(csr(&[], &[], &[]).contains(not_fitting));
    assert!(csr(&[0, 1, 2], &[1, 0], &[0.1, f64::INFINITY]).contains("F[1, 0] = inf"));
}

#[test]
fn memory_is_refused_before_any_work() {
    let scene = cube(2).scene();
    let needed = Dense::forecast(scene.len());
    let progress = Progress::default();
    let options = DenseOptions { tolerance: 1e-2, seed: 0, memory: needed - 1 };
    match Dense::new(&scene, options, &progress) {
        Err(Error::Memory { needed: told, available, .. }) => assert_eq!((told, available), (needed, needed - 1)),
        other => panic!("{other:?}"),
    }
    assert_eq!(progress.get(), (0, 0), "work was announced");
    let f = Dense::new(&scene, DenseOptions { memory: needed, ..options }, &progress).unwrap();
    assert_eq!(f.nbytes() as u64, needed, "the forecast of a convex scene is exact");
    let (done, total) = progress.get();
    assert!(done == total && total > 0);
}

#[test]
fn memory_for_sampling_is_refused_before_sampling() {
    // What stands in the way must be sampled, and samples need room beside the matrix.
    let scene = box_in_box(2).scene();
    let options = DenseOptions { tolerance: 1e-2, seed: 0, memory: Dense::forecast(scene.len()) };
    let attempt = |memory: u64| Dense::new(&scene, DenseOptions { memory, ..options }, &Progress::default());
    let Err(Error::Memory { needed, .. }) = attempt(options.memory) else { panic!("accepted") };
    assert!(needed > options.memory);
    // What it tells is what it takes, no less and no more.
    assert!(matches!(attempt(needed - 1), Err(Error::Memory { needed: again, .. }) if again == needed));
    let f = attempt(needed).unwrap();
    assert!((f.nbytes() as u64) <= needed, "{} bytes held, {needed} told", f.nbytes());
}

#[test]
fn tolerances_out_of_range_are_refused() {
    let scene = cube(1).scene();
    for tolerance in [0.0, 1.0, -1e-3, 1e-11, f64::NAN] {
        let options = DenseOptions { tolerance, seed: 0, memory: PLENTY };
        assert!(invalid(Dense::new(&scene, options, &Progress::default())).contains("is outside [1e-10, 1)"));
    }
}

#[test]
fn stopping_interrupts() {
    let scene = box_in_box(1).scene();
    let options = DenseOptions { tolerance: 1e-2, seed: 0, memory: PLENTY };
    let progress = Progress::default();
    progress.stop();
    assert!(matches!(Dense::new(&scene, options, &progress), Err(Error::Interrupted)));
    // In the middle of the work, from another thread: 3 million pairs by the dearest kernel take seconds.
    let scene = cube(15).scene();
    let progress = Arc::new(Progress::default());
    let stopper = std::thread::spawn({
        let progress = Arc::clone(&progress);
        move || {
            while progress.get().0 == 0 {
                std::thread::sleep(Duration::from_millis(1));
            }
            progress.stop();
        }
    });
    let outcome = Dense::new(&scene, DenseOptions { tolerance: 1e-8, ..options }, &progress);
    stopper.join().unwrap();
    assert!(matches!(outcome, Err(Error::Interrupted)));
    let (done, total) = progress.get();
    assert!(0 < done && done < total, "{done} of {total}");
}

/// The mean over patches of the variance of `values` (one vector a seed), and that of the squared errors told.
fn variances(values: &[Vec<f64>], errors: &[Vec<f64>]) -> (f64, f64) {
    let seeds = values.len() as f64;
    let (mut spread, mut told) = (0.0, 0.0);
    for k in 0..values[0].len() {
        let mean = values.iter().map(|v| v[k]).sum::<f64>() / seeds;
        spread += values.iter().map(|v| (v[k] - mean).powi(2)).sum::<f64>() / (seeds - 1.0);
        told += errors.iter().map(|e| e[k].powi(2)).sum::<f64>() / seeds;
    }
    (spread, told)
}

#[test]
fn the_standard_error_is_the_spread_over_seeds() {
    let scene = stack_in_box(1).scene();
    let n = scene.len();
    let random = Random::new(43);
    let x: Vec<f64> = (0..n).map(|_| random.uniform()).collect();
    for tolerance in [3e-2, 5e-3] {
        let (mut values, mut errors) = (Vec::new(), Vec::new());
        for seed in 0..16 {
            let f = dense(&scene, tolerance, seed);
            let mut image = vec![0.0; n];
            f.apply(&x, 1, &mut image);
            values.push(image);
            errors.push(f.standard_error(&x, 1).unwrap());
        }
        let (spread, told) = variances(&values, &errors);
        // 52 patches with 15 degrees of freedom each: were they independent, the ratio of variances would be known to
        // sqrt(2/780) = 5 %. They share segments, which leaves fewer, and stopping when the error looks small makes it look
        // smaller: 40 % in the error.
        let ratio = (spread / told).sqrt();
        assert!((0.7..1.4).contains(&ratio), "tolerance {tolerance}: spread {ratio} times what is told");
    }
}

#[test]
fn realisations_of_the_sampling_error_have_its_standard_error() {
    let scene = stack_in_box(1).scene();
    let n = scene.len();
    let f = dense(&scene, 1e-2, 0);
    let random = Random::new(44);
    let x: Vec<f64> = (0..2 * n).map(|_| random.uniform()).collect();
    let told = f.standard_error(&x, 2).unwrap();
    let draws: Vec<Vec<f64>> = (0..256).map(|draw| f.sampling_error(&x, 2, draw).unwrap()).collect();
    assert_ne!(draws[0], draws[1]);
    for k in 0..2 * n {
        let variance = draws.iter().map(|draw| draw[k] * draw[k]).sum::<f64>() / 256.0;
        // Chi-square with 256 degrees of freedom: the root is known to 4.4 %, and 104 of them stay within 4 sigma.
        assert_close(variance.sqrt(), told[k], 0.18 * told[k]);
        let mean = draws.iter().map(|draw| draw[k]).sum::<f64>() / 256.0;
        assert!(mean.abs() <= 4.0 * told[k] / 16.0, "{mean} of {}", told[k]);
    }
    // A realisation keeps reciprocity: what i gains from j, j gains from i. Sum of A_i y_i (dF x)_i is symmetric in x, y.
    let product = |x: &[f64], y: &[f64]| -> f64 {
        f.sampling_error(x, 1, 3).unwrap().iter().zip(y).zip(scene.areas()).map(|((dfx, y), area)| area * y * dfx).sum()
    };
    let (x, y) = x.split_at(n);
    let (xy, yx) = (product(x, y), product(y, x));
    // Sums of a thousand terms of either sign, each below 1e-2.
    assert!(xy.abs() > 1e-6);
    assert_close(xy, yx, 1e-15);
}

#[test]
fn a_sheet_with_two_sides_sees_with_both() {
    // A sheet in the middle of the unit cube, parallel to the floor: front and back receive half of all each, and the
    // closed scene keeps its row sums.
    let mesh = plate(vec3(0.25, 0.25, 0.5), 0.5 * Vec3::X, 0.5 * Vec3::Y, 1);
    let both = mesh.and(&cube(1)).scene_with(1, Sides::Both, |_, _| 0.5, |_, _| 0.0);
    let f = dense(&both, 3e-3, 0);
    let (table, n) = (table(&f), both.len());
    let half = n / 2;
    for (i, sum) in f.row_sums().into_iter().enumerate() {
        // The outer sides of the cube see nothing.
        let expected = if (half + 2..n).contains(&i) { 0.0 } else { 1.0 };
        assert_close(sum, expected, 3e-3);
    }
    for i in 0..2 {
        assert_eq!(table[i * n + half + i], 0.0, "the two sides do not see each other");
        // By symmetry in z = 1/2 front and back see the same amount of the walls.
        let walls = |i: usize| table[i * n + 2..i * n + half].iter().sum::<f64>();
        assert_close(walls(i), walls(half + i), 6e-3);
    }
}

#[test]
fn an_open_scene_loses_what_it_does_not_reach() {
    let scene = two_plates(4).scene();
    let f = dense(&scene, 1e-6, 0);
    let mean: f64 = remainder(&f).iter().zip(scene.areas()).map(|(r, area)| r * area).sum::<f64>() / 2.0;
    // Howell C-11 for unit squares at distance 1, at the tolerance asked for.
    assert_close(mean, 1.0 - 0.199_824_895_698_387, 1e-6);
}

/// An operator with areas whose reciprocity is wrong by construction, and only what a trait object must have.
struct Lopsided([f64; 2]);

impl FormFactors for Lopsided {
    fn len(&self) -> usize {
        2
    }

    fn areas(&self) -> Option<&[f64]> {
        Some(&self.0)
    }

    fn gather(&self, i: usize, x: &[f64], out: &mut [f64]) {
        let (f, bands) = ([0.5, 0.25][i], out.len());
        out.iter_mut().enumerate().for_each(|(b, value)| *value = f * x[(1 - i) * bands + b]);
    }

    fn shoot(&self, i: usize, amount: &[f64], out: &mut [f64]) {
        let f = [0.25, 0.5][i];
        amount.iter().enumerate().for_each(|(b, a)| out[(1 - i) * amount.len() + b] += f * a);
    }

    fn row(&self, i: usize, out: &mut [f64]) {
        out.copy_from_slice(&[[0.0, 0.5], [0.25, 0.0]][i]);
    }

    fn nbytes(&self) -> usize {
        0
    }
}

#[test]
fn broken_reciprocity_is_seen() {
    // A_0 F_01 = 0.5 and A_1 F_10 = 0.75: off by a quarter, a third of the larger.
    assert_close(reciprocity_error(&Lopsided([1.0, 3.0])).unwrap(), 1.0 / 3.0, 1e-15);
    assert_eq!(reciprocity_error(&Lopsided([1.0, 2.0])), Some(0.0));
    let mut out = [0.0; 4];
    Lopsided([1.0, 2.0]).apply(&[1.0, 2.0, 3.0, 4.0], 2, &mut out);
    assert_eq!(out, [1.5, 2.0, 0.25, 0.5]);
    assert_eq!(remainder(&Lopsided([1.0, 2.0])), [0.5, 0.75]);
}

#[test]
fn a_scene_of_one_patch_exchanges_nothing() {
    let scene: Scene = Mesh::of_triangles(&[[Vec3::ZERO, Vec3::X, Vec3::Y]]).scene();
    let f = dense(&scene, 1e-3, 0);
    assert_eq!(f.row_sums(), [0.0]);
    assert_eq!(table(&f), [0.0]);
    let mut out = [1.0];
    f.shoot(0, &[2.0], &mut out);
    assert_eq!(out, [1.0]);
}
