//! Products backwards, importance, many states: each against what it must equal.

use radiosity::assembly::matrix::{DenseMatrix, SparseMatrix};
use radiosity::assembly::{Dense, FormFactors, Transposed};
use radiosity::progress::Progress;
use radiosity::solve::{Method, Options, System, adjoint::importance, solve, solve_from, states};

use crate::common::{assert_close, dense, two_plates};

const OPTIONS: Options = Options { tolerance: 1e-12, max_iterations: None, memory: u64::MAX };

fn quiet(_: &radiosity::solve::Step, _: &[f64], _: &[f64]) -> radiosity::Result<()> {
    Ok(())
}

/// The operator of two plates, and the same as plain matrices, which know nothing of reciprocity.
fn operators() -> (Dense, DenseMatrix, SparseMatrix) {
    let f = dense(&two_plates(3).scene(), 1e-4, 0);
    let n = f.len();
    let mut rows = vec![0.0; n * n];
    rows.chunks_exact_mut(n).enumerate().for_each(|(i, row)| f.row(i, row));
    let start = (0..=n).map(|i| i * n).collect();
    let index = (0..n * n).map(|k| (k % n) as u32).collect();
    let plain = DenseMatrix::new(n, rows.clone()).unwrap();
    (f, plain, SparseMatrix::new(start, index, rows).unwrap())
}

fn numbers(count: usize, seed: u64) -> Vec<f64> {
    (0..count).map(|k| ((k as u64 + 1) * (2 * seed + 1) % 97) as f64 / 97.0 - 0.4).collect()
}

fn product(x: &[f64], y: &[f64]) -> f64 {
    x.iter().zip(y).map(|(x, y)| x * y).sum()
}

#[test]
fn backwards_is_the_transpose_of_forwards() {
    let (f, plain, sparse) = operators();
    let n = f.len();
    for bands in [1, 2, 11] {
        let (x, y) = (numbers(n * bands, 3), numbers(n * bands, 8));
        for f in [&f as &dyn FormFactors, &plain, &sparse] {
            let (mut forwards, mut backwards) = (vec![0.0; x.len()], vec![0.0; x.len()]);
            f.apply(&x, bands, &mut forwards);
            f.apply_transposed(&y, bands, &mut backwards);
            // Sums of some hundred products.
            assert_close(product(&y, &forwards), product(&x, &backwards), 1e-13);
            let transposed = Transposed(f);
            let (mut row, mut column) = (vec![0.0; n], vec![0.0; n]);
            transposed.row(2, &mut row);
            f.shoot(2, &[1.0], &mut column);
            assert_eq!(row, column);
            let mut gathered = vec![0.0; bands];
            transposed.gather(4, &y, &mut gathered);
            gathered.iter().zip(&backwards[4 * bands..]).for_each(|(a, b)| assert_close(*a, *b, 1e-14));
            let mut shot = vec![0.0; n];
            transposed.shoot(3, &[2.0], &mut shot);
            f.row(3, &mut row);
            shot.iter().zip(&row).for_each(|(a, b)| assert_close(*a, 2.0 * b, 1e-15));
            assert_eq!(transposed.areas(), None);
            assert_eq!(transposed.nbytes(), f.nbytes());
        }
    }
}

#[test]
fn importance_tells_what_arrives() {
    let (f, plain, sparse) = operators();
    let n = f.len();
    let rho: Vec<f64> = numbers(n, 5).iter().map(|x| 0.4 + 0.5 * x).collect();
    let emission: Vec<f64> = numbers(n, 2).iter().map(|x| x.abs()).collect();
    let weights = numbers(n, 6);
    for f in [&f as &dyn FormFactors, &plain, &sparse] {
        let system = System { form_factors: f, emission: &emission, reflectance: &rho, bands: 1 };
        let solved = solve(&system, Method::Direct, &OPTIONS, &mut quiet).unwrap();
        let found = importance(f, &rho, 1, &weights, 1e-13, &mut quiet).unwrap();
        // Residuals of 1e-12, times 1 / (1 - 0.7).
        assert_close(product(&weights, &solved.irradiance), product(&emission, &found), 1e-11);
    }
}

#[test]
fn importance_refuses_what_no_system_has() {
    let (f, ..) = operators();
    let n = f.len();
    let told = |rho: f64, w: f64| {
        let (mut rho, mut w) = ([vec![0.5; n], vec![rho; 1]].concat(), [vec![1.0; n], vec![w; 1]].concat());
        rho.swap_remove(3);
        w.swap_remove(3);
        importance(&f, &rho, 1, &w, 1e-6, &mut quiet).unwrap_err().to_string()
    };
    assert!(told(1.5, 1.0).contains("patch 3: reflectance 1.5 is outside [0, 1]"));
    assert!(told(0.5, f64::NAN).contains("patch 3: the weight is NaN, not finite"));
}

#[test]
fn a_start_at_the_solution_ends_at_once() {
    let (f, ..) = operators();
    let n = f.len();
    let (emission, rho) = (vec![1.0; n], vec![0.8; n]);
    let system = System { form_factors: &f, emission: &emission, reflectance: &rho, bands: 1 };
    let solved = solve(&system, Method::Gmres, &OPTIONS, &mut quiet).unwrap();
    let again = solve_from(&system, &solved.radiosity, &OPTIONS, &mut quiet).unwrap();
    assert!(solved.history.len() > 3);
    assert_eq!(again.history.len(), 1);
    assert!(solve_from(&system, &[1.0], &OPTIONS, &mut quiet).unwrap_err().to_string().contains("has 1 values"));
}

/// Superposition: B(E_1 + E_2) = B(E_1) + B(E_2), in chunks of states of any width.
#[test]
fn states_add_up() {
    let (f, ..) = operators();
    let n = f.len();
    for (seed, states, bands) in [(1, 3, 1), (2, 40, 3), (3, 97, 1), (4, 100, 2), (5, 7, 100)] {
        let mut emission: Vec<f64> = numbers(n * bands * states, seed).iter().map(|x| x.abs()).collect();
        // The last state is the sum of the two first.
        emission.chunks_exact_mut(states).for_each(|row| row[states - 1] = row[0] + row[1]);
        let rho: Vec<f64> = numbers(n * bands, seed + 1).iter().map(|x| 0.4 + 0.6 * x).collect();
        let system = System { form_factors: &f, emission: &emission, reflectance: &rho, bands };
        let all = states::solve(&system, states, Method::Gmres, &OPTIONS, &Progress::default()).unwrap();
        assert_eq!(all.failure, None);
        for row in all.radiosity.chunks_exact(states) {
            // Residuals of 1e-12 of emissions of up to 1 in each of 36 patches, times 1 / (1 - 0.8).
            assert_close(row[states - 1], row[0] + row[1], 1e-10);
        }
    }
}
