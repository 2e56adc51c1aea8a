//! The operator of quasi-random rays: exact for constants, linear in between, and right on the average.

use radiosity::Progress;
use radiosity::accuracy::{Options, solve};
use radiosity::assembly::rays::{Field, Sample};
use radiosity::assembly::{FormFactors, Order};
use radiosity::scene::Sides;

use crate::common::{PLENTY, box_in_box, cube, dense, on_threads};

fn options(tolerance: f64, order: Order) -> Options {
    Options { tolerance, order, refine: true, seed: 0, memory: PLENTY }
}

#[test]
fn samples_of_a_patch_are_independent_of_others() {
    let of = |patch, scramble, index| Sample::new(7, patch, scramble, index).numbers::<4>(0);
    assert_eq!(of(3, 1, 5), of(3, 1, 5));
    assert_ne!(of(3, 1, 5), of(4, 1, 5));
    assert_ne!(of(3, 1, 5), of(3, 2, 5));
    // Stages take other dimensions of the same sequence.
    let sample = Sample::new(7, 3, 1, 5);
    let all = sample.numbers::<9>(0);
    assert_eq!(sample.numbers::<3>(4), [all[4], all[5], all[6]]);
}

#[test]
fn fields_are_linear_between_corners() {
    let field = Field::new(Order::Linear, 1, vec![1.0, 3.0, 5.0]);
    let at = |v: f64, w: f64| {
        let mut out = [10.0];
        field.add(0, [v, w], &[2.0], &mut out);
        out[0]
    };
    assert_eq!([at(0.0, 0.0), at(1.0, 0.0), at(0.0, 1.0)], [12.0, 16.0, 20.0]);
    assert_eq!(at(0.25, 0.5), 10.0 + 2.0 * (0.25 * 1.0 + 0.25 * 3.0 + 0.5 * 5.0));
    assert_eq!(field.means(), vec![3.0]);
}

#[test]
fn both_orders_agree_with_dense_factors() {
    // On patches so small that their size hardly matters, against all pairs and 200 bounces by hand.
    let scene = box_in_box(4).scene_with(1, Sides::Front, |_, _| 0.6, |i, _| if i < 32 { 4.0 } else { 0.0 });
    let f = dense(&scene, 1e-4, 0);
    let mut exact = scene.emission().to_vec();
    let mut h = vec![0.0; scene.len()];
    for _ in 0..200 {
        f.apply(&exact, 1, &mut h);
        exact.iter_mut().zip(scene.emission()).zip(&h).for_each(|((b, e), h)| *b = e + 0.6 * h);
    }
    for order in [Order::Constant, Order::Linear] {
        let outcome = solve(&scene, &options(0.01, order), &Progress::default()).unwrap();
        let norm = |x: &dyn Fn(usize) -> f64| {
            scene.areas().iter().enumerate().map(|(i, area)| area * x(i) * x(i)).sum::<f64>().sqrt()
        };
        let off = norm(&|i| outcome.radiosity[i] - exact[i]) / norm(&|i| exact[i] - scene.emission()[i]);
        // 1 % of the rays, and what constant patches of a quarter of the wall lack: a few per cent at most.
        assert!(off < 0.04, "{order:?}: {off}");
        assert!(outcome.error_estimate() <= 0.01, "{order:?}: {}", outcome.error_estimate());
    }
}

#[test]
fn a_furnace_is_exact_for_any_number_of_threads() {
    let scene = cube(3).scene_with(2, Sides::Front, |_, b| [0.5, 0.9][b], |_, b| [1.0, 3.0][b]);
    let run =
        |threads| on_threads(threads, || solve(&scene, &options(0.1, Order::Linear), &Progress::default()).unwrap());
    let outcome = run(1);
    for (k, b) in outcome.radiosity.iter().enumerate() {
        // E / (1 - rho), to the residual 1e-3 of the pilot's solve times that of what follows it, 3e-2.
        let exact = [2.0, 30.0][k % 2];
        assert!((b - exact).abs() < 1e-4 * exact, "{b} instead of {exact}");
    }
    for threads in [2, 7] {
        assert_eq!(run(threads).radiosity, outcome.radiosity, "{threads} threads");
    }
}
