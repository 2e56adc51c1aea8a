//! The operator of quasi-random rays: exact for constants, linear in between, and right on the average.

use radiosity::Progress;
use radiosity::accuracy::{Options, solve};
use radiosity::assembly::rays::{Field, Sample};
use radiosity::assembly::{FormFactors, Order, Trips};
use radiosity::direct::Lights;
use radiosity::scene::Sides;

use rayon::prelude::*;

use crate::common::{PLENTY, Random, assert_close, box_in_box, cube, dense, on_threads, table};

fn options(tolerance: f64, order: Order) -> Options {
    Options { tolerance, order, refine: true, seed: 0, memory: PLENTY }
}

#[test]
fn samples_of_a_patch_are_independent_of_others() {
    let of = |patch, scramble, index| {
        Sample::rays(7, patch, scramble, index..index + 1).map(|sample| sample.numbers).collect::<Vec<_>>()
    };
    assert_eq!(of(3, 1, 5), of(3, 1, 5));
    assert_ne!(of(3, 1, 5), of(4, 1, 5));
    assert_ne!(of(3, 1, 5), of(3, 2, 5));
    // A sequence goes on where it was left.
    let all: Vec<_> = Sample::rays(7, 3, 1, 0..8).map(|sample| sample.numbers).collect();
    assert_eq!(of(3, 1, 5), all[5..6]);
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

/// Origins and arrivals of 16 rays from each of 5 patches, at random.
fn ends() -> Vec<([f64; 2], u32)> {
    let random = Random::new(11);
    let place = || {
        let (v, w) = (random.uniform(), random.uniform());
        if v + w < 1.0 { [v, w] } else { [1.0 - v, 1.0 - w] }
    };
    (0..80).map(|_| (place(), random.below(5) as u32)).collect()
}

/// Trips with these ends; one ray in eight is lost.
fn made_up(order: Order) -> Trips {
    let mut trips = Trips::new(order, 16, &[1.0, 2.0, 3.0, 4.0, 5.0]);
    let ends = ends();
    trips.rows().enumerate().for_each(|(i, mut row)| {
        for k in 0..16 {
            row.start(k, ends[16 * i + k].0);
            if k % 8 > 0 {
                row.arrive(k, ends[16 * i + k].1);
            }
        }
    });
    trips
}

#[test]
fn gather_row_shoot_and_apply_are_one_matrix() {
    let trips = made_up(Order::Linear);
    let rays = trips.rays();
    let n = rays.len();
    assert_eq!(n, 5);
    let random = Random::new(2);
    let x: Vec<f64> = (0..2 * n).map(|_| random.between(-1.0, 1.0)).collect();
    let matrix = table(rays);
    let mut applied = vec![0.0; 2 * n];
    rays.apply(&x, 2, &mut applied);
    for i in 0..n {
        let mut gathered = [0.0; 2];
        rays.gather(i, &x, &mut gathered);
        let mut shot = vec![0.0; 2 * n];
        rays.shoot(i, &[1.0, -2.0], &mut shot);
        for b in 0..2 {
            let product: f64 = (0..n).map(|j| matrix[i * n + j] * x[2 * j + b]).sum();
            // Sums of 16 numbers of the size of 1 in another order.
            assert_close(gathered[b], product, 1e-13);
            assert_close(applied[2 * i + b], product, 1e-13);
            for j in 0..n {
                assert_close(shot[2 * j + b], matrix[j * n + i] * [1.0, -2.0][b], 1e-13);
            }
        }
    }
    let areas: f64 = rays.areas().unwrap().iter().sum();
    assert_close(areas, 15.0, 1e-13);
    assert!(!rays.is_closed());
    // Its linear field has the same means, and so has the constant one. Rounding again.
    for order in [Order::Constant, Order::Linear] {
        let trips = made_up(order);
        let mut field = Field::new(order, 2, vec![1.0; 2 * n * order.coefficients()]);
        trips.add_gathered(&x, &mut field);
        field.means().iter().zip(&applied).for_each(|(mean, h)| assert_close(*mean, 1.0 + h, 1e-13));
    }
    // Corner by corner it is what the row of each patch makes of the values that its rays find.
    let mut trips = made_up(Order::Linear);
    let mut field = Field::new(Order::Linear, 2, vec![0.0; 6 * n]);
    trips.add_gathered(&x, &mut field);
    let ends = ends();
    trips.rows().enumerate().for_each(|(i, row)| {
        let mut corners = vec![0.0; 6];
        let value = |k: usize, out: &mut [f64]| {
            if !k.is_multiple_of(8) {
                out.iter_mut().zip(&x[2 * ends[16 * i + k].1 as usize..]).for_each(|(out, x)| *out += x);
            }
        };
        row.add_projected(2, value, &mut corners);
        for (c, place) in [[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]].into_iter().enumerate() {
            let mut at = [0.0; 2];
            field.add(i as u32, place, &[1.0; 2], &mut at);
            assert_eq!(at[..], corners[2 * c..][..2]);
        }
    });
}

#[test]
fn projections_keep_constants_and_lines() {
    // Starts at the middles of a fine even grid of triangles, whose moments are those of the whole to 1 / 64^2.
    const SIDE: usize = 64;
    let mut grid = Vec::new();
    for a in 0..SIDE {
        for b in 0..SIDE - a {
            grid.push([(a as f64 + 1.0 / 3.0) / SIDE as f64, (b as f64 + 1.0 / 3.0) / SIDE as f64]);
            if a + b + 1 < SIDE {
                grid.push([(a as f64 + 2.0 / 3.0) / SIDE as f64, (b as f64 + 2.0 / 3.0) / SIDE as f64]);
            }
        }
    }
    let mut trips = Trips::new(Order::Linear, grid.len(), &[1.0]);
    // The values at the corners of the function whose value at the start of ray k is `value(k)`.
    let mut projected = |value: &(dyn Fn(usize) -> f64 + Sync)| {
        let rows = trips.rows().map(|mut row| {
            let mut corners = [0.0; 3];
            grid.iter().enumerate().for_each(|(k, place)| row.start(k, *place));
            row.add_projected(1, |k, out| out[0] += value(k), &mut corners);
            corners
        });
        rows.collect::<Vec<_>>()[0]
    };
    let corners = projected(&|_| 7.0);
    // Rounding of sums of 4096 numbers.
    corners.iter().for_each(|c| assert_close(*c, 7.0, 1e-11));
    // 2 + 3 l_1 - 4 l_2; places are kept in 16 bits, finer than the grid.
    let corners = projected(&|k| 2.0 + 3.0 * grid[k][0] - 4.0 * grid[k][1]);
    for (c, exact) in corners.iter().zip([2.0, 5.0, -2.0]) {
        assert_close(*c, exact, 4.0 / 4096.0);
    }
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
        let outcome = solve(&scene, &Lights::default(), &options(0.01, order), &Progress::default()).unwrap();
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
    let run = |threads| {
        on_threads(threads, || {
            solve(&scene, &Lights::default(), &options(0.1, Order::Linear), &Progress::default()).unwrap()
        })
    };
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
