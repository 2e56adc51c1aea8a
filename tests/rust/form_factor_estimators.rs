//! Monte Carlo and hemicube: closed forms, error bars that mean what they say, the same bits every time; and the repair
//! of row sums.

use radiosity::assembly::balance::{balanced, balanced_exchange, reciprocity_error, remainder};
use radiosity::assembly::{Block, Estimator, FormFactors, Sampled, SampledOptions};
use radiosity::form_factor::emitter::{Emitter, Tally};
use radiosity::form_factor::hemicube::{Hemicube, Hemicubes, Setting};
use radiosity::form_factor::monte_carlo;
use radiosity::scene::Scene;
use radiosity::visibility::Bvh;
use radiosity::{Error, Progress};

use crate::common::{
    PLENTY, Random, assert_close, box_in_box, cube, dense, invalid, on_threads, plate, table, two_plates, vec3,
};

/// Unit squares face to face at distance 1 (Howell C-11), and sharing an edge at a right angle (Howell C-14).
const OPPOSITE: f64 = 0.199_824_895_698_387;
const ADJACENT: f64 = 0.200_043_776_075_403;

const BOTH: [Estimator; 2] = [Estimator::MonteCarlo, Estimator::Hemicube];

fn sampled(scene: &Scene, estimator: Estimator, tolerance: f64, seed: u64) -> Sampled {
    Sampled::new(scene, estimator, SampledOptions { tolerance, seed, memory: PLENTY }, &Progress::default()).unwrap()
}

/// F from the first side of `cube(1)` to each of the five others: the mean of two rows, in sums of two columns.
fn from_side_to_sides(f: &dyn FormFactors) -> [f64; 5] {
    let (table, n) = (table(f), f.len());
    std::array::from_fn(|k| (0..2).map(|i| table[i * n + 2 * k + 2] + table[i * n + 2 * k + 3]).sum::<f64>() / 2.0)
}

#[test]
fn monte_carlo_meets_the_closed_forms_of_the_cube() {
    let scene = cube(1).scene();
    for seed in 0..4 {
        let f = sampled(&scene, Estimator::MonteCarlo, 1e-2, seed);
        let rays = f.rays() as f64 / 12.0 * 2.0;
        for (k, value) in from_side_to_sides(&f).into_iter().enumerate() {
            let exact = if k == 0 { OPPOSITE } else { ADJACENT };
            // Two rows of about as many rays each: four standard errors of a binomial count, and 3 % for "about".
            assert_close(value, exact, 4.0 * 1.03 * (exact * (1.0 - exact) / rays).sqrt());
        }
    }
}

#[test]
fn delta_form_factors_sum_to_one() {
    for resolution in [2, 16, 64, 256] {
        let (mut sum, mut cells, mut worst) = (0.0, 0, 0.0f64);
        let cell_area = (2.0 / f64::from(resolution)).powi(2);
        Hemicube::new(resolution)
            .try_for_each(|[x, y, z], delta| {
                sum += delta;
                cells += 1;
                // The density in the middle times the area of the cell: z / (pi r^4) on every face.
                let middle = z / (std::f64::consts::PI * (x * x + y * y + z * z).powi(2)) * cell_area;
                worst = worst.max((delta - middle).abs() / cell_area);
                Ok(())
            })
            .unwrap();
        assert_eq!(cells, 3 * resolution * resolution);
        // 3 r^2 differences of numbers up to 1/4: an eps or so each, of either sign.
        assert_close(sum, 1.0, f64::EPSILON * f64::from(resolution * resolution));
        // The midpoint rule: h^2 / 24 times second derivatives, which are at most 4 / pi each in x and y, and rounding
        // of four terms over the area.
        assert!(worst <= cell_area / 24.0 * 8.0 / std::f64::consts::PI + 1e-15 / cell_area, "{resolution}: {worst:e}");
    }
}

#[test]
fn the_error_of_the_hemicube_falls_with_resolution_and_with_points() {
    let scene = cube(1).scene();
    let (tree, hemicubes) = (Bvh::of_scene(&scene), Hemicubes::default());
    let rows = |resolution: usize, points: u32| -> Vec<f64> {
        let (mut rows, mut tally) = (vec![0.0; 12 * 12], Tally::new(12));
        for (i, out) in rows.chunks_exact_mut(12).enumerate() {
            let (emitter, setting) = (Emitter::new(&scene, &tree, i), Setting { resolution, points });
            let row = hemicubes.evaluate(&emitter, setting, 7, &mut tally, &Progress::default()).unwrap();
            row.iter().for_each(|&(j, f)| out[j as usize] = f);
            // Every ray of a closed scene arrives: conservation to the rounding of a million additions.
            assert_close(row.iter().map(|(_, f)| f).sum(), 1.0, 1e-12);
        }
        rows
    };
    let off = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(a, b)| (a - b).abs()).sum::<f64>() / 12.0;
    // Aliasing is what distinguishes resolutions at the same points. Cells on an edge fall to either side: for each
    // doubling the error of a cell falls to a quarter while twice as many are on edges, of either sign: 2^-1.5, or 2^-1
    // were all of them of one sign. Three doublings leave at most an eighth; a quarter allows for the luck of an angle.
    let fine = rows(5, 0);
    let aliasing = [0, 3].map(|resolution| off(&rows(resolution, 0), &fine));
    assert!(aliasing[1] < 0.25 * aliasing[0] && aliasing[0] < 0.1, "{aliasing:?}");
    // At a fine resolution, proximity: a scrambled net of m points gains m^-0.5 at the least and m^-1.5 on smooth
    // integrands; at an edge that two patches share it has a kink. Four times the points leave at most half, and 0.6
    // for the luck of one scramble, over the mean of 12 rows.
    let exact = table(&dense(&scene, 1e-8, 0));
    let proximity = [0, 1, 2].map(|points| off(&rows(3, points), &exact));
    assert!(proximity[1] < 0.6 * proximity[0] && proximity[2] < 0.6 * proximity[1], "{proximity:?}");
}

#[test]
fn both_meet_the_tolerance_with_something_in_the_way() {
    let scene = box_in_box(2).scene();
    let n = scene.len();
    let reference = dense(&scene, 1e-3, 0);
    let exact = table(&reference);
    for (estimator, tolerance) in [(Estimator::MonteCarlo, 3e-2), (Estimator::Hemicube, 6e-2)] {
        let f = sampled(&scene, estimator, tolerance, 1);
        assert!(f.error_estimate() <= tolerance && f.error_estimate() > 0.2 * tolerance, "{}", f.error_estimate());
        let table = table(&f);
        for i in 0..n {
            let off: f64 = (0..n).map(|j| (table[i * n + j] - exact[i * n + j]).abs()).sum();
            // The estimate is the expectation of a sum of some 30 terms: 1.5 times that is about four of its
            // deviations.
            assert!(off <= 1.5 * tolerance + reference.error_estimate(), "{estimator:?}, row {i}: {off}");
        }
        // Every ray arrives at a front: it is a closed scene with its fronts inside.
        assert!(remainder(&f).iter().all(|r| r.abs() < 1e-12));
        // In units of the largest exchange: below the sum of two errors of a row.
        let reciprocity = reciprocity_error(&f).unwrap();
        assert!(reciprocity > 0.0 && reciprocity < 1.0, "{reciprocity}");
        let largest = exact.iter().zip(0..).map(|(f, k)| f * scene.areas()[k / n]).fold(0.0, f64::max);
        let area = scene.areas().iter().copied().fold(0.0, f64::max);
        assert!(reciprocity * largest <= 2.0 * 1.5 * tolerance * area, "{reciprocity}");
        let kept = f.nbytes();
        assert!(kept < 24 * n * n + 40 * n, "{kept}");
    }
}

#[test]
fn backs_receive_nothing_and_block() {
    // A plate between two others, its back to the lower one: nothing gets through, and nobody receives what meets the
    // back.
    let wall = plate(vec3(-4.0, -4.0, 0.5), vec3(9.0, 0.0, 0.0), vec3(0.0, 9.0, 0.0), 2);
    let scene = two_plates(1).and(&wall).scene();
    for estimator in BOTH {
        let f = sampled(&scene, estimator, 0.1, 0);
        let (table, n) = (table(&f), scene.len());
        assert!(table[..2 * n].iter().all(|f| *f == 0.0), "the lower plate sees backs only");
        // The upper plate sees the front of the wall, as in the test of the dense operator.
        assert!((2..4).all(|i| table[i * n + 4..][..8].iter().sum::<f64>() > 0.5));
    }
    let (tree, mut tally) = (Bvh::of_scene(&scene), Tally::new(scene.len()));
    let hits = monte_carlo::row(&Emitter::new(&scene, &tree, 0), 0.1, 0, &mut tally, &Progress::default()).unwrap();
    // The rule of succession: nobody met by m rays is not nobody.
    assert!(hits.counts.is_empty() && hits.error == 1.0 / f64::from(hits.rays + 2));
}

#[test]
fn bits_do_not_depend_on_the_number_of_threads() {
    let scene = box_in_box(1).scene();
    for estimator in BOTH {
        let everything = |threads, seed| {
            on_threads(threads, || {
                let f = sampled(&scene, estimator, 0.1, seed);
                (table(&f), f.error_estimate(), f.rays())
            })
        };
        let one = everything(1, 5);
        assert_eq!(everything(2, 5), one);
        assert_eq!(everything(5, 5), one);
        assert_ne!(everything(2, 6).0, one.0);
    }
}

#[test]
fn the_standard_error_of_monte_carlo_is_the_spread_over_seeds() {
    // An open scene with backs: the class of rays that nobody receives counts too.
    let scene = two_plates(1).and(&plate(vec3(0.2, 0.2, 0.5), vec3(0.5, 0.0, 0.0), vec3(0.0, 0.5, 0.0), 1)).scene();
    let n = scene.len();
    let random = Random::new(45);
    let x: Vec<f64> = (0..2 * n).map(|_| random.uniform()).collect();
    let (mut told, mut images, mut drawn) = (vec![0.0; 2 * n], Vec::new(), vec![0.0; 2 * n]);
    for seed in 0..128 {
        let f = sampled(&scene, Estimator::MonteCarlo, 5e-2, seed);
        let mut image = vec![0.0; 2 * n];
        f.apply(&x, 2, &mut image);
        images.push(image);
        f.standard_error(&x, 2).unwrap().iter().zip(&mut told).for_each(|(e, told)| *told += e * e / 128.0);
        f.sampling_error(&x, 2, seed).unwrap().iter().zip(&mut drawn).for_each(|(e, drawn)| *drawn += e * e / 128.0);
    }
    for k in 0..2 * n {
        let mean = images.iter().map(|image| image[k]).sum::<f64>() / 128.0;
        let spread = images.iter().map(|image| (image[k] - mean).powi(2)).sum::<f64>() / 127.0;
        // Chi-square with 127 degrees of freedom: the root is known to 6.3 %, and 12 of them stay within 4 sigma.
        assert_close(spread.sqrt(), told[k].sqrt(), 0.25 * told[k].sqrt());
        assert_close(drawn[k].sqrt(), told[k].sqrt(), 0.25 * told[k].sqrt());
    }
    // A constant x in a closed scene is known without error, as every ray arrives.
    let closed = cube(1).scene();
    let f = sampled(&closed, Estimator::MonteCarlo, 5e-2, 0);
    assert!(f.standard_error(&[3.0; 12], 1).unwrap().iter().all(|e| *e < 1e-7));
}

#[test]
fn the_hemicube_tells_the_error_of_a_product() {
    let scene = box_in_box(1).scene();
    let n = scene.len();
    let f = sampled(&scene, Estimator::Hemicube, 0.1, 0);
    let exact = dense(&scene, 1e-3, 0);
    let random = Random::new(46);
    let x: Vec<f64> = (0..n).map(|_| random.uniform()).collect();
    let (mut image, mut truth) = (vec![0.0; n], vec![0.0; n]);
    f.apply(&x, 1, &mut image);
    exact.apply(&x, 1, &mut truth);
    let told = f.standard_error(&x, 1).unwrap();
    // The comparisons are with something coarser, so on the whole the error is smaller than told.
    let total = |values: &[f64]| values.iter().map(|v| v * v).sum::<f64>().sqrt();
    let off: Vec<f64> = image.iter().zip(&truth).map(|(a, b)| a - b).collect();
    assert!(total(&off) < total(&told) && total(&told) < 20.0 * total(&off), "{} of {}", total(&off), total(&told));
    let draws: Vec<f64> = (0..64).map(|draw| total(&f.sampling_error(&x, 1, draw).unwrap())).collect();
    // Each is the root of a sum of n squares, known to 1 / sqrt(2 n) = 14 % even if all were equally large; 64 of them
    // know their mean eight times better.
    assert_close(total(&draws) / 8.0, total(&told), 0.15 * total(&told));
}

#[test]
fn bad_tolerances_little_memory_and_stops_are_told() {
    let scene = box_in_box(1).scene();
    for estimator in BOTH {
        let attempt = |tolerance: f64, memory: u64, progress: &Progress| {
            Sampled::new(&scene, estimator, SampledOptions { tolerance, seed: 0, memory }, progress)
        };
        for tolerance in [0.0, 1.0, -1e-3, f64::NAN] {
            assert!(invalid(attempt(tolerance, PLENTY, &Progress::default())).contains("is outside [1e-10, 1)"));
        }
        let (least, progress) = (Sampled::forecast(scene.len()), Progress::default());
        assert!(matches!(attempt(0.1, least - 1, &progress), Err(Error::Memory { needed, .. }) if needed == least));
        assert_eq!(progress.get(), (0, 0), "work was announced");
        assert!(matches!(attempt(0.1, least, &progress), Err(Error::Memory { needed, .. }) if needed > least));
        let progress = Progress::default();
        attempt(0.1, PLENTY, &progress).unwrap();
        assert_eq!(progress.get(), (24, 24));
        progress.stop();
        assert!(matches!(attempt(0.1, PLENTY, &progress), Err(Error::Interrupted)));
    }
}

#[test]
fn blocks_of_rows_are_the_rows_of_the_whole_to_the_bit() {
    // Open at one side, so that some rays leave: they are a class of their own in the errors.
    let scene = two_plates(3).scene();
    let (n, bands, tree) = (scene.len(), 2, Bvh::of_scene(&scene));
    let random = Random::new(11);
    let x: Vec<f64> = (0..n * bands).map(|_| random.uniform()).collect();
    for estimator in BOTH {
        let options = SampledOptions { tolerance: 0.2, seed: 5, memory: PLENTY };
        let whole = Sampled::new(&scene, estimator, options, &Progress::default()).unwrap();
        let (mut product, mut row) = (vec![0.0; n * bands], vec![0.0; n]);
        whole.apply(&x, bands, &mut product);
        let sums = whole.row_sums();
        let errors = whole.standard_error(&x, bands).unwrap();
        let draw = whole.sampling_error(&x, bands, 3).unwrap();
        let (mut before, mut rays, mut reached, mut bytes) = (0, 0, 0.0f64, 0);
        for range in [0..1, 1..n / 2, n / 2..n] {
            let progress = Progress::default();
            let block = Block::new(&scene, &tree, estimator, options, range.clone(), &progress).unwrap();
            let count = range.len() as u64;
            assert_eq!((progress.get(), block.len(), block.patches()), ((count, count), range.len(), n));
            let part = range.start * bands..range.end * bands;
            let mut out = vec![0.0; part.len()];
            block.apply(&x, bands, &mut out);
            assert_eq!(out, product[part.clone()]);
            assert_eq!(block.row_sums(), sums[range.clone()]);
            assert_eq!(block.standard_error(&x, bands), errors[part.clone()]);
            assert_eq!(block.sampling_error(&x, bands, 3, before), draw[part]);
            let (mut expected, last) = (vec![0.0; n], range.end - 1);
            block.row(last - range.start, &mut row);
            whole.row(last, &mut expected);
            assert_eq!(row, expected);
            before += block.entries() as u64;
            rays += block.rays();
            reached = reached.max(block.error_estimate());
            bytes += block.nbytes();
        }
        assert_eq!((rays, reached), (whole.rays(), whole.error_estimate()));
        assert!(bytes < whole.nbytes(), "the whole has the columns, too");
        let attempt = |range: std::ops::Range<usize>, memory: u64| {
            Block::new(&scene, &tree, estimator, SampledOptions { memory, ..options }, range, &Progress::default())
        };
        for range in [0..0, 3..n + 1, n..n] {
            assert!(invalid(attempt(range, PLENTY)).contains(&format!("are not rows of {n} patches")));
        }
        assert!(matches!(attempt(0..4, 10), Err(Error::Memory { what, .. }) if what.starts_with("4 rows of")));
    }
}

#[test]
fn balancing_makes_row_sums_exact_and_keeps_reciprocity() {
    let scene = box_in_box(2).scene();
    let f = dense(&scene, 3e-2, 0);
    let (repaired, moved) = balanced(&f, PLENTY, &Progress::default()).unwrap();
    let worst = |f: &dyn FormFactors| remainder(f).iter().map(|r| r.abs()).fold(0.0, f64::max);
    // Sums of 60 terms: some tens of roundings.
    assert!(worst(&f) > 1e-4 && worst(&repaired) <= 1e-13, "{} to {:e}", worst(&f), worst(&repaired));
    assert!(reciprocity_error(&repaired).unwrap() <= 2.0 * f64::EPSILON);
    // No row can be mended by less than it lacks, to rounding.
    assert!(moved >= (1.0 - 1e-12) * worst(&f) && moved <= 10.0 * worst(&f), "{moved} for {}", worst(&f));
    let (before, after) = (table(&f), table(&repaired));
    for (a, b) in before.iter().zip(&after) {
        assert!(*b >= 0.0 && (*a > 0.0 || *b == 0.0), "who sees nobody still sees nobody");
    }
    assert_eq!(repaired.error_estimate(), f.error_estimate() + moved);
    // Once more, there is nothing left to do.
    assert!(balanced(&repaired, PLENTY, &Progress::default()).unwrap().1 <= 1e-13);
    let bits = |threads| on_threads(threads, || table(&balanced(&f, PLENTY, &Progress::default()).unwrap().0));
    assert_eq!(bits(1), bits(3));
}

#[test]
fn the_repair_is_the_least_change() {
    // Any other symmetric change of the same rows is larger: a change Z with row sums of 0 is orthogonal to D in the
    // metric 1 / w. Around a cycle of four, +1 -1 +1 -1 is such a change.
    let random = Random::new(47);
    let n = 7;
    let exchange: Vec<f64> = (0..n * (n - 1) / 2).map(|_| random.between(0.1, 1.0)).collect();
    let at = |i: usize, j: usize| i.max(j) * (i.max(j) - 1) / 2 + i.min(j);
    let areas: Vec<f64> = (0..n)
        .map(|i| (0..n).filter(|j| *j != i).map(|j| exchange[at(i, j)]).sum::<f64>() * random.between(0.95, 1.05))
        .collect();
    let (changed, _) = balanced_exchange(&areas, &exchange, &Progress::default()).unwrap();
    let d: Vec<f64> = changed.iter().zip(&exchange).map(|(a, b)| (a - b) / (b * b)).collect();
    let largest = d.iter().map(|d| d.abs()).fold(0.0, f64::max);
    for _ in 0..50 {
        let mut order: Vec<usize> = (0..n).collect();
        (0..4).for_each(|k| order.swap(k, k + random.below(n - k)));
        let cycle = (0..4).map(|k| d[at(order[k], order[(k + 1) % 4])] * [1.0, -1.0][k % 2]).sum::<f64>();
        // D is computed from areas known to 1e-14, and divided by w as small as 1e-2.
        assert_close(cycle, 0.0, 1e-10 * largest);
    }
}

#[test]
fn entries_that_would_become_negative_are_fixed_at_zero() {
    // Four patches. The sums of row 3 ask for less than half of what it has; what is kept must not be negative.
    let exchange = [1.0, 1.0, 1.0, 0.1, 0.1, 1.0];
    let areas = [1.2, 1.9, 2.2, 0.3];
    let (changed, moved) = balanced_exchange(&areas, &exchange, &Progress::default()).unwrap();
    assert!(changed.iter().all(|g| *g >= 0.0), "{changed:?}");
    let at = |i: usize, j: usize| changed[i.max(j) * (i.max(j) - 1) / 2 + i.min(j)];
    for i in 0..4 {
        assert_close((0..4).filter(|j| *j != i).map(|j| at(i, j)).sum(), areas[i], 1e-13);
    }
    assert!(moved > 0.0);
}

#[test]
fn what_cannot_be_balanced_is_refused() {
    let open = dense(&two_plates(2).scene(), 1e-2, 0);
    let text = invalid(balanced(&open, PLENTY, &Progress::default()));
    assert!(text.contains("patch ") && text.contains("row sum 0.1") && text.contains("not closed"), "{text}");
    // Two patches that see each other only: no symmetric exchange fits two areas.
    assert!(invalid(balanced_exchange(&[1.0, 1.1], &[1.0], &Progress::default())).contains("cannot be made"));
    let closed = dense(&cube(1).scene(), 1e-2, 0);
    assert!(matches!(balanced(&closed, 100, &Progress::default()), Err(Error::Memory { .. })));
    let (progress, closed) = (Progress::default(), dense(&box_in_box(1).scene(), 1e-2, 0));
    progress.stop();
    assert!(matches!(balanced(&closed, PLENTY, &progress), Err(Error::Interrupted)));
}
