//! Solvers against each other, against closed forms (furnace, sums of bounces), and against the conservation of energy.

use radiosity::assembly::matrix::{DenseMatrix, SparseMatrix};
use radiosity::assembly::{Dense, FormFactors};
use radiosity::scene::{Scene, Sides};
use radiosity::solve::southwell::ambient;
use radiosity::solve::{Audit, METHODS, Method, Options, Solved, Step, System, solve};
use radiosity::{Error, Result};

use crate::common::{
    Mesh, PLENTY, Random, assert_close, cube, dense, icosphere, invalid, stack_in_box, table, two_plates,
};

fn options(tolerance: f64) -> Options {
    Options { tolerance, max_iterations: None, memory: PLENTY }
}

fn run(system: &System, method: Method, options: &Options) -> Result<Solved> {
    solve(system, method, options, &mut |_, _, _| Ok(()))
}

fn system<'a>(f: &'a dyn FormFactors, scene: &'a Scene) -> System<'a> {
    System { form_factors: f, emission: scene.emission(), reflectance: scene.reflectance(), bands: scene.bands() }
}

/// Area-weighted norms of the difference, one a band.
fn distances(scene: &Scene, x: &[f64], y: &[f64]) -> Vec<f64> {
    let mut sums = vec![0.0; scene.bands()];
    for (k, (x, y)) in x.iter().zip(y).enumerate() {
        sums[k % scene.bands()] += scene.areas()[k / scene.bands()] * (x - y).powi(2);
    }
    sums.into_iter().map(f64::sqrt).collect()
}

fn norms(scene: &Scene, x: &[f64]) -> Vec<f64> {
    distances(scene, x, &vec![0.0; x.len()])
}

/// Three bands: moderate and mixed, dark, bright.
fn materials(mesh: &Mesh) -> Scene {
    mesh.scene_with(
        3,
        Sides::Front,
        |i, b| [[0.2, 0.5, 0.8][i % 3], 0.05, 0.9][b],
        |i, b| if i % 5 == b { 1.0 + i as f64 } else { 0.0 },
    )
}

/// A cube, and one without its last side: no blockers, so F is exact to its tolerance.
fn closed_and_open() -> [(&'static str, Scene, Dense); 2] {
    let closed = cube(2);
    let mut open = closed.clone();
    open.faces.truncate(open.faces.len() - 8);
    [("closed", closed), ("open", open)].map(|(name, mesh)| {
        let scene = materials(&mesh);
        let f = dense(&scene, 1e-6, 0);
        (name, scene, f)
    })
}

#[test]
fn all_methods_agree() {
    for (name, scene, f) in &closed_and_open() {
        let system = system(f, scene);
        let direct = run(&system, Method::Direct, &options(1e-12)).unwrap();
        assert!(direct.radiosity.iter().all(|b| b.is_finite() && *b >= 0.0));
        let size = norms(scene, &direct.radiosity);
        for (method_name, method) in METHODS {
            let solved = run(&system, method, &options(1e-12)).unwrap();
            // A residual of 1e-12 of E leaves at most 1e-12 / (1 - 0.9) of B (see `solve`): 1e-10 has a factor of 10.
            for (b, d) in distances(scene, &solved.radiosity, &direct.radiosity).iter().enumerate() {
                assert!(*d <= 1e-10 * size[b], "{name}, {method_name}, band {b}: {:e}", d / size[b]);
            }
            assert!(solved.residual <= 1e-12, "{method_name}: {:e}", solved.residual);
            assert_eq!(solved.failure, None);
            assert_eq!(solved.history.last().map(|step| step.residual), Some(solved.residual));
            assert_eq!(solved.irradiance.len(), solved.radiosity.len());
        }
    }
}

#[test]
fn all_methods_agree_on_bands_of_very_different_difficulty() {
    // Solved at once, after one bounce, after some, after hundreds: a band that is done must not be spoilt by the others.
    let rho = [0.0, 1e-9, 0.5, 0.99];
    let scene = cube(2).scene_with(
        4,
        Sides::Front,
        |i, b| if i % 7 == 0 { 0.5 * rho[b] } else { rho[b] },
        |i, _| {
            if i < 8 { 5.0 } else { 0.0 }
        },
    );
    let f = dense(&scene, 1e-4, 0);
    let system = system(&f, &scene);
    let direct = run(&system, Method::Direct, &options(1e-12)).unwrap();
    let size = norms(&scene, &direct.radiosity);
    for (name, method) in METHODS {
        let solved = run(&system, method, &options(1e-12)).unwrap();
        for (b, d) in distances(&scene, &solved.radiosity, &direct.radiosity).iter().enumerate() {
            // 1e-12 / (1 - 0.99) of E.
            assert!(*d <= 1.1e-10 * size[b], "{name}, band {b}: {:e}", d / size[b]);
        }
    }
}

#[test]
fn all_methods_agree_on_plain_matrices() {
    // No areas, no symmetry: rows of random numbers that sum to at most 0.95.
    let (n, bands) = (30, 2);
    let random = Random::new(51);
    let mut values: Vec<f64> = (0..n * n).map(|_| (random.uniform() - 0.5).max(0.0)).collect();
    for row in values.chunks_exact_mut(n) {
        let sum: f64 = row.iter().sum();
        row.iter_mut().for_each(|v| *v *= 0.95 / sum);
    }
    let emission: Vec<f64> = (0..n * bands).map(|_| random.uniform()).collect();
    let reflectance: Vec<f64> = (0..n * bands).map(|_| random.uniform()).collect();
    let start = (0..=n).map(|i| i * n).collect();
    let sparse = SparseMatrix::new(start, (0..n * n).map(|k| (k % n) as u32).collect(), values.clone()).unwrap();
    let matrix = DenseMatrix::new(n, values.clone()).unwrap();
    for f in [&matrix as &dyn FormFactors, &sparse] {
        let system = System { form_factors: f, emission: &emission, reflectance: &reflectance, bands };
        for (name, method) in METHODS {
            let solved = run(&system, method, &options(1e-13)).unwrap();
            // The equation itself: B = E + rho F B, to the residual asked for, in the largest of 60 entries.
            for (k, b) in solved.radiosity.iter().enumerate() {
                let (i, band) = (k / bands, k % bands);
                let h: f64 = (0..n).map(|j| values[i * n + j] * solved.radiosity[j * bands + band]).sum();
                assert_close(*b, emission[k] + reflectance[k] * h, 1e-12);
                assert_close(solved.irradiance[k], h, 1e-12);
            }
            assert!(solved.audit.is_none() && solved.standard_error.is_none(), "{name}");
        }
    }
}

#[test]
fn jacobi_steps_are_bounces() {
    let [(_, scene, f), _] = closed_and_open();
    let system = system(&f, &scene);
    let mut seen: Vec<(Step, Vec<f64>, Vec<f64>)> = Vec::new();
    let limited = Options { max_iterations: Some(12), ..options(1e-12) };
    let outcome = solve(&system, Method::Jacobi, &limited, &mut |step, radiosity, unshot| {
        seen.push((step.clone(), radiosity.to_vec(), unshot.to_vec()));
        Ok(())
    });
    assert!(outcome.unwrap().failure.is_some());
    assert_eq!(seen.len(), 12);
    let bounced = |light: &[f64]| {
        let mut out = vec![0.0; light.len()];
        f.apply(light, 3, &mut out);
        out.iter().zip(scene.reflectance()).map(|(h, rho)| h * rho).collect::<Vec<_>>()
    };
    let mut light = scene.emission().to_vec();
    let mut sum = light.clone();
    for (k, (step, radiosity, unshot)) in seen.iter().enumerate() {
        light = bounced(&light);
        sum.iter_mut().zip(&light).for_each(|(sum, l)| *sum += l);
        let next = bounced(&light);
        for j in 0..sum.len() {
            // A dozen additions of numbers of the size of B.
            assert_close(radiosity[j], sum[j], 1e-14 * sum[j].max(1.0));
            assert_close(unshot[j], next[j], 1e-13 * sum[j].max(1.0));
        }
        // What a step reports is what the observer saw.
        for b in 0..3 {
            let power: f64 = (0..scene.len()).map(|i| scene.areas()[i] * unshot[3 * i + b]).sum();
            assert_close(step.unshot[b], power, 1e-13 * power.max(1.0));
        }
        let residual =
            norms(&scene, unshot).iter().zip(norms(&scene, scene.emission())).map(|(r, e)| r / e).fold(0.0, f64::max);
        assert_close(step.residual, residual, 1e-13);
        assert!(step.residual > 0.0, "step {k}");
    }
}

#[test]
fn the_first_sweep_of_gauss_seidel_by_hand() {
    let f = DenseMatrix::new(3, vec![0.0, 0.5, 0.5, 0.25, 0.0, 0.5, 0.5, 0.25, 0.0]).unwrap();
    let system = System { form_factors: &f, emission: &[1.0, 0.0, 2.0], reflectance: &[0.5; 3], bands: 1 };
    let mut first = Vec::new();
    solve(&system, Method::GaussSeidel, &options(1e-12), &mut |_, radiosity, _| {
        if first.is_empty() {
            first = radiosity.to_vec();
        }
        Ok(())
    })
    .unwrap();
    // From B = E: B_0 = 1 + (2/2)/2 = 3/2; B_1 = ((3/2)/4 + 2/2)/2 = 11/16; B_2 = 2 + ((3/2)/2 + (11/16)/4)/2 = 315/128:
    // exact in binary.
    assert_eq!(first, [1.5, 0.6875, 2.460_937_5]);
}

#[test]
fn southwell_shoots_the_brightest_first_and_loses_no_light() {
    let [(_, scene, f), _] = closed_and_open();
    let system = system(&f, &scene);
    let brightest = (0..scene.len())
        .max_by(|&i, &j| {
            let power = |i: usize| scene.areas()[i] * scene.emission()[3 * i..][..3].iter().sum::<f64>();
            power(i).total_cmp(&power(j))
        })
        .unwrap();
    let solution = run(&system, Method::Direct, &options(1e-12)).unwrap().radiosity;
    let mut previous = vec![0.0; solution.len()];
    let mut unshot_power = f64::INFINITY;
    let mut steps = 0;
    let solved = solve(&system, Method::Southwell, &options(1e-6), &mut |step, radiosity, unshot| {
        if steps == 0 {
            let shot: Vec<usize> =
                (0..scene.len()).filter(|&i| radiosity[3 * i..][..3].iter().any(|b| *b > 0.0)).collect();
            assert_eq!(shot, [brightest]);
            assert_eq!(radiosity[3 * brightest..][..3], scene.emission()[3 * brightest..][..3]);
        }
        // Light is only ever added, and never more than there is in the end (up to the residual of that end).
        for k in 0..solution.len() {
            assert!(radiosity[k] >= previous[k] && radiosity[k] <= solution[k] * (1.0 + 1e-10), "step {steps}");
            assert!(unshot[k] >= 0.0);
        }
        // A shot puts rho F <= 1 of what was unshot back on the shelf.
        let total = step.unshot.iter().sum::<f64>();
        assert!(total <= unshot_power * (1.0 + 1e-12), "step {steps}: {total} after {unshot_power}");
        (previous, unshot_power) = (radiosity.to_vec(), total);
        steps += 1;
        Ok(())
    })
    .unwrap();
    assert_eq!(steps, solved.history.len());
    assert!(steps > scene.len());
}

#[test]
fn gathering_needs_fewer_steps_than_bouncing_and_krylov_the_fewest() {
    for (name, scene, f) in &closed_and_open() {
        let system = system(f, scene);
        let history = |method| run(&system, method, &options(1e-10)).unwrap().history;
        let (jacobi, gauss_seidel, gmres) =
            (history(Method::Jacobi), history(Method::GaussSeidel), history(Method::Gmres));
        // Stein & Rosenberg 1948: for a matrix without negative entries Gauss-Seidel is asymptotically faster.
        assert!(gauss_seidel.len() < jacobi.len(), "{name}: {} and {}", gauss_seidel.len(), jacobi.len());
        // Step k of Jacobi lies in the space of which step k of GMRES has the least residual, in every band.
        assert!(gmres.len() <= jacobi.len());
        for (k, (g, j)) in gmres.iter().zip(&jacobi).enumerate() {
            assert!(g.residual <= j.residual * (1.0 + 1e-9), "{name}, step {k}: {} and {}", g.residual, j.residual);
        }
        assert!(gmres[5].residual < 0.5 * jacobi[5].residual);
    }
}

#[test]
fn gmres_tells_the_residual_of_every_step() {
    // Carried along by recurrences, it is that of the system to rounding, also after the restart at step 60: bands so close
    // to 1 that a chain of patches needs more steps than that.
    let n = 150usize;
    let chain: Vec<f64> = (0..n * n).map(|k| if (k / n).abs_diff(k % n) == 1 { 0.5 } else { 0.0 }).collect();
    let f = DenseMatrix::new(n, chain).unwrap();
    let reflectance: Vec<f64> = (0..2 * n).map(|k| [0.9999, 0.6][k % 2]).collect();
    let emission: Vec<f64> = (0..2 * n).map(|k| if k < 2 { 1.0 } else { 0.0 }).collect();
    let system = System { form_factors: &f, emission: &emission, reflectance: &reflectance, bands: 2 };
    let mut steps = 0;
    solve(&system, Method::Gmres, &options(1e-9), &mut |_, radiosity, unshot| {
        steps += 1;
        let mut arriving = vec![0.0; 2 * n];
        f.apply(radiosity, 2, &mut arriving);
        for k in 0..2 * n {
            let exact = emission[k] + reflectance[k] * arriving[k] - radiosity[k];
            // Up to 150 vectors of length 1 or less, with coefficients of the size of the radiosity, some tens.
            assert!((unshot[k] - exact).abs() < 1e-11, "step {steps}: {} and {exact}", unshot[k]);
        }
        Ok(())
    })
    .unwrap();
    assert!(steps > 60, "{steps} steps");
}

#[test]
fn gmres_ends_when_the_space_is_exhausted() {
    // Twelve patches make a space of twelve dimensions, in which the least residual is zero (Saad & Schultz 1986). The
    // thirteenth step is for rounding.
    let scene =
        cube(1).scene_with(1, Sides::Front, |i, _| 0.9 + 0.008 * i as f64, |i, _| if i == 0 { 1.0 } else { 0.0 });
    let f = dense(&scene, 1e-6, 0);
    let steps = |method| run(&system(&f, &scene), method, &options(1e-13)).unwrap().history.len();
    assert!(steps(Method::Gmres) <= 13, "{} steps", steps(Method::Gmres));
    assert!(steps(Method::GaussSeidel) > 100);
}

#[test]
fn furnace() {
    // Everything emits E and reflects rho: B = E + rho B everywhere, whatever the shape.
    for mesh in [cube(2), icosphere(1).reversed()] {
        let rho = [0.0, 0.3, 0.95];
        let scene = mesh.scene_with(3, Sides::Front, |_, b| rho[b], |_, b| 1.0 + b as f64);
        let f = dense(&scene, 1e-6, 0);
        let system = system(&f, &scene);
        for (name, method) in METHODS {
            let solved = run(&system, method, &options(1e-10)).unwrap();
            for (k, value) in solved.radiosity.iter().enumerate() {
                let b = k % 3;
                let exact = (1.0 + b as f64) / (1.0 - rho[b]);
                // Rows that sum to 1 within 1e-6, and the residual of 1e-10 on a patch that may be a tenth of the mean, both
                // amplified by the bounces.
                let tolerance = exact * (1e-6 * rho[b] + 1e-9) / (1.0 - rho[b]);
                assert!((value - exact).abs() <= tolerance, "{name}, band {b}: {value} is not {exact}");
            }
        }
    }
}

#[track_caller]
fn assert_balanced(audit: &Audit) {
    for b in 0..audit.emitted.len() {
        let parts = [audit.absorbed[b], audit.left[b], audit.unshot[b]];
        // By reciprocity the books close exactly; sums of 100 patches, rounded.
        let size = audit.emitted[b] + parts.iter().map(|p| p.abs()).sum::<f64>();
        assert_close(parts.iter().sum(), audit.emitted[b], 1e-13 * size);
    }
}

#[test]
fn energy_is_conserved() {
    for (name, scene, f) in &closed_and_open() {
        let system = system(f, scene);
        for (method_name, method) in METHODS {
            let solved = run(&system, method, &options(1e-12)).unwrap();
            let audit = solved.audit.unwrap();
            assert_balanced(&audit);
            for b in 0..3 {
                let power: f64 = (0..scene.len()).map(|i| scene.areas()[i] * scene.emission()[3 * i + b]).sum();
                assert_close(audit.emitted[b], power, 1e-13 * power);
                // Converged, so nothing is under way: 1e-12 of E in the norm, sqrt(area x n) at most in the sum.
                assert!(audit.unshot[b].abs() < 1e-11 * power, "{name}, {method_name}: {}", audit.unshot[b]);
                let share = audit.left[b] / power;
                // F of the closed scene was asked for at 1e-6; bounces of 0.9 lose ten times that.
                if *name == "closed" {
                    assert!(share.abs() < 1e-5);
                } else {
                    assert!(share > 0.05);
                }
                assert!(audit.absorbed[b] > 0.0);
            }
            // Stopped early, what is missing is under way.
            let early = run(&system, method, &Options { max_iterations: Some(2), ..options(1e-12) }).unwrap();
            let audit = early.audit.unwrap();
            assert_balanced(&audit);
            assert_eq!(early.failure.is_none(), method == Method::Direct);
            if early.failure.is_some() {
                assert!(audit.unshot.iter().zip(&audit.emitted).any(|(unshot, emitted)| *unshot > 1e-3 * emitted));
            }
        }
    }
}

#[test]
fn running_out_of_steps_returns_what_was_reached() {
    let [(_, scene, f), _] = closed_and_open();
    let system = system(&f, &scene);
    for (name, method) in METHODS.into_iter().filter(|(name, _)| *name != "direct") {
        let mut last = Vec::new();
        let limited = Options { max_iterations: Some(3), ..options(1e-9) };
        let solved = solve(&system, method, &limited, &mut |_, radiosity, _| {
            last = radiosity.to_vec();
            Ok(())
        })
        .unwrap();
        let text = solved.failure.unwrap();
        assert!(text.contains(name) && text.contains("after 3 steps") && text.contains("1.000e-9"), "{text}");
        assert_eq!(solved.history.len(), 3);
        assert_eq!(solved.radiosity, last);
        assert_eq!(solved.residual, solved.history[2].residual);
        assert!(solved.residual > 1e-9);
        assert!(solved.residual < solved.history[0].residual || ["southwell", "overshooting"].contains(&name));
        // One step more than enough is no failure.
        let enough = run(&system, method, &options(1e-3)).unwrap();
        let limited = Options { max_iterations: Some(enough.history.len()), ..options(1e-3) };
        assert_eq!(run(&system, method, &limited).unwrap().failure, None);
        let limited = Options { max_iterations: Some(enough.history.len() - 1), ..options(1e-3) };
        assert!(run(&system, method, &limited).unwrap().failure.is_some());
    }
}

#[test]
fn direct_without_hope_says_so() {
    // No factorisation leaves 1e-18.
    let [(_, scene, f), _] = closed_and_open();
    for max_iterations in [None, Some(1), Some(5)] {
        let solved = run(&system(&f, &scene), Method::Direct, &Options { max_iterations, ..options(1e-18) }).unwrap();
        assert!(solved.failure.unwrap().contains("direct"));
        assert!(solved.residual > 1e-18 && solved.residual < 1e-12 && solved.history.len() == 1);
    }
}

#[test]
fn divergence_is_told() {
    // No form factors: rows that sum to 2. Each bounce makes 1.8 times the light.
    let f = DenseMatrix::new(3, vec![0.0, 1.0, 1.0, 1.0, 0.0, 1.0, 1.0, 1.0, 0.0]).unwrap();
    let system = System { form_factors: &f, emission: &[1.0, 1.0, 1.0], reflectance: &[0.9; 3], bands: 1 };
    for method in [Method::Jacobi, Method::GaussSeidel, Method::Southwell] {
        let solved = run(&system, method, &options(1e-3)).unwrap();
        assert!(solved.failure.unwrap().contains("diverged"));
        assert_eq!(solved.error_estimate, f64::INFINITY);
    }
}

#[test]
fn an_observer_stops_the_solver() {
    let [(_, scene, f), _] = closed_and_open();
    for (name, method) in METHODS {
        let stop_at = if method == Method::Direct { 1 } else { 2 };
        let mut calls = 0;
        let outcome = solve(&system(&f, &scene), method, &options(1e-12), &mut |_, _, _| {
            calls += 1;
            if calls == stop_at { Err(Error::Interrupted) } else { Ok(()) }
        });
        assert!(matches!(outcome, Err(Error::Interrupted)), "{name}");
        assert_eq!(calls, stop_at, "{name} went on");
    }
}

#[test]
fn methods_by_name() {
    for (name, method) in METHODS {
        assert_eq!(name.parse::<Method>().unwrap(), method);
        assert_eq!(method.name(), name);
    }
    for wrong in ["southwel", "", "Direct"] {
        let text = invalid(wrong.parse::<Method>());
        assert!(text.contains(&format!("\"{wrong}\"")), "{text}");
        assert!(METHODS.iter().all(|(name, _)| text.contains(&format!("\"{name}\""))), "{text}");
    }
}

#[test]
fn ambient_light_of_a_furnace_is_its_whole_solution() {
    // Before the first shot everything is unshot: E + rho x E / (1 - rho) = E / (1 - rho).
    let rho = [0.25, 0.8];
    let scene = cube(2).scene_with(2, Sides::Front, |_, b| rho[b], |_, b| 3.0 - b as f64);
    let light = ambient(scene.areas(), scene.emission(), scene.reflectance(), 2);
    for b in 0..2 {
        let e = 3.0 - b as f64;
        assert_close(e + rho[b] * light[b], e / (1.0 - rho[b]), 1e-13);
    }
    // Along the way it is what is missing, and at the end nothing: the mean of B + rho x ambient stays the solution, up to
    // the row sums, known to 1e-6 and amplified by the bounces.
    let f = dense(&scene, 1e-6, 0);
    let mut steps = 0;
    solve(&system(&f, &scene), Method::Southwell, &options(1e-4), &mut |_, radiosity, unshot| {
        let light = ambient(scene.areas(), unshot, scene.reflectance(), 2);
        for b in 0..2 {
            let shown: f64 = (0..scene.len())
                .map(|i| scene.areas()[i] * (radiosity[2 * i + b] + unshot[2 * i + b] + rho[b] * light[b]))
                .sum();
            let exact = 6.0 * (3.0 - b as f64) / (1.0 - rho[b]);
            assert_close(shown, exact, 1e-5 * exact);
        }
        steps += 1;
        Ok(())
    })
    .unwrap();
    assert!(steps > 48);
}

#[test]
fn no_emission_no_light() {
    let scene = cube(1).scene_with(2, Sides::Front, |_, _| 0.7, |_, _| 0.0);
    let f = dense(&scene, 1e-3, 0);
    // All dark, and one band of two dark.
    let half: Vec<f64> = (0..2 * scene.len()).map(|k| (k % 2) as f64).collect();
    for (name, method) in METHODS {
        let solved = run(&system(&f, &scene), method, &options(1e-8)).unwrap();
        assert!(solved.radiosity.iter().chain(&solved.irradiance).all(|x| *x == 0.0), "{name}");
        assert_eq!((solved.residual, solved.error_estimate), (0.0, 0.0), "{name}");
        assert!(solved.history.iter().all(|step| step.residual == 0.0 && step.unshot == [0.0, 0.0]));
        let solved = run(&System { emission: &half, ..system(&f, &scene) }, method, &options(1e-8)).unwrap();
        for (k, value) in solved.radiosity.iter().enumerate() {
            if k % 2 == 0 { assert_eq!(*value, 0.0, "{name}") } else { assert!(*value > 1.0, "{name}") }
        }
        assert!(solved.error_estimate.is_finite(), "{name}");
    }
}

#[test]
fn a_system_without_losses_is_refused() {
    let n = 4;
    // Rows that sum to exactly 1: light goes round for ever.
    let f = DenseMatrix::new(n, vec![0.25; n * n]).unwrap();
    let emission = vec![1.0; 2 * n];
    let white = |patch: usize, rho: f64| -> Vec<f64> {
        (0..2 * n)
            .map(|k| {
                if k % 2 == 0 {
                    0.5
                } else if k / 2 == patch {
                    rho
                } else {
                    1.0
                }
            })
            .collect()
    };
    for (name, method) in METHODS {
        let lossless = white(0, 1.0);
        let system = System { form_factors: &f, emission: &emission, reflectance: &lossless, bands: 2 };
        let text = invalid(run(&system, method, &options(1e-8)));
        assert!(text.contains("band 1") && text.contains("no finite solution"), "{name}: {text}");
        // One patch that absorbs half is loss enough: B = E + F B adds up to the emission over the absorbed share.
        let lossy = white(2, 0.5);
        let solved = run(&System { reflectance: &lossy, ..system }, method, &options(1e-12)).unwrap();
        // The mean H obeys 4 = 0.5 H (what is emitted is absorbed by patch 2): H = 8.
        solved.irradiance.iter().skip(1).step_by(2).for_each(|h| assert_close(*h, 8.0, 1e-9));
    }
    // Open scenes may be white.
    let scene = two_plates(1).scene_with(1, Sides::Front, |_, _| 1.0, |_, _| 1.0);
    let f = dense(&scene, 1e-6, 0);
    for (_, method) in METHODS {
        let solved = run(&system(&f, &scene), method, &options(1e-10)).unwrap();
        // Alike in all patches by symmetry of the triangles: B = 1 / (1 - F), F by Howell C-11.
        let mean = solved.radiosity.iter().sum::<f64>() / 4.0;
        assert_close(mean, 1.0 / (1.0 - 0.199_824_895_698_387), 1e-5);
    }
}

#[test]
fn a_scene_without_losses_is_refused_at_any_tolerance() {
    let scene = cube(3).scene_with(1, Sides::Front, |_, _| 0.5, |_, _| 1.0);
    let f = dense(&scene, 1e-3, 0);
    let white = vec![1.0; scene.len()];
    let outcome = run(&System { reflectance: &white, ..system(&f, &scene) }, Method::Direct, &options(1e-6));
    assert!(matches!(outcome, Err(Error::Invalid(_))), "{outcome:?}");
}

#[test]
fn problems_of_a_system_are_told_together() {
    let f = DenseMatrix::new(2, vec![0.0, 0.5, 0.5, 0.0]).unwrap();
    let system =
        System { form_factors: &f, emission: &[1.0, -1.0, 0.0], reflectance: &[0.5, 1.5, f64::NAN, 0.0], bands: 2 };
    let wrong = Options { tolerance: 0.0, max_iterations: Some(0), memory: PLENTY };
    let text = invalid(run(&system, Method::Jacobi, &wrong));
    for wanted in [
        "tolerance 0 is outside (0, 1)",
        "max_iterations 0",
        "emission has 3 values; 2 patches of 2 bands need 4",
        "patch 0: reflectance 1.5 is outside [0, 1] (band 1)",
        "patch 1: reflectance NaN is outside [0, 1] (band 0)",
    ] {
        assert!(text.lines().any(|line| line.contains(wanted)), "no line says \"{wanted}\":\n{text}");
    }
    assert_eq!(text.lines().count(), 5, "{text}");
    let negative = System { emission: &[1.0, -1.0, 0.0, f64::INFINITY], reflectance: &[0.5; 4], ..system };
    let text = invalid(run(&negative, Method::Jacobi, &options(1e-3)));
    assert!(text.contains("patch 0: emission -1") && text.contains("patch 1: emission inf"), "{text}");
    let empty = DenseMatrix::new(0, vec![]).unwrap();
    let system = System { form_factors: &empty, emission: &[], reflectance: &[], bands: 1 };
    assert!(invalid(run(&system, Method::Jacobi, &options(1e-3))).contains("empty"));
    for tolerance in [f64::NAN, 1.0, -1.0] {
        let system = System { form_factors: &f, emission: &[1.0; 2], reflectance: &[0.5; 2], bands: 1 };
        assert!(invalid(run(&system, Method::Jacobi, &options(tolerance))).contains("tolerance"));
    }
}

#[test]
fn a_system_of_no_bands_is_refused() {
    let f = DenseMatrix::new(1, vec![0.0]).unwrap();
    let system = System { form_factors: &f, emission: &[], reflectance: &[], bands: 0 };
    assert!(invalid(run(&system, Method::Jacobi, &options(1e-3))).contains("band"));
}

#[test]
fn a_factorisation_that_does_not_fit_is_refused() {
    let [(_, scene, f), _] = closed_and_open();
    let n = scene.len() as u64;
    let small = Options { memory: 8 * n * n - 1, ..options(1e-8) };
    match run(&system(&f, &scene), Method::Direct, &small) {
        Err(Error::Memory { needed, available, remedy, .. }) => {
            assert_eq!((needed, available), (8 * n * n, 8 * n * n - 1));
            assert!(remedy.contains("gauss_seidel"));
        }
        other => panic!("{other:?}"),
    }
    assert!(run(&system(&f, &scene), Method::GaussSeidel, &small).is_ok());
}

#[test]
fn the_error_estimate_is_the_distance_to_the_solution() {
    let mut checked = 0;
    for (name, scene, f) in &closed_and_open() {
        // One band at a time, because the estimate is that of the worst band.
        for b in 0..3 {
            let band = |x: &[f64]| x.iter().skip(b).step_by(3).copied().collect::<Vec<_>>();
            let (emission, reflectance) = (band(scene.emission()), band(scene.reflectance()));
            let system = System { form_factors: f, emission: &emission, reflectance: &reflectance, bands: 1 };
            let exact = run(&system, Method::Direct, &options(1e-13)).unwrap().radiosity;
            let q = reflectance.iter().copied().fold(0.0, f64::max) * f.row_sums().into_iter().fold(0.0, f64::max);
            for (method_name, method) in METHODS.into_iter().filter(|(_, m)| *m != Method::Direct) {
                for tolerance in [1e-1, 1e-2, 1e-4, 1e-8] {
                    let solved = run(&system, method, &options(tolerance)).unwrap();
                    let norm = |x: &[f64], y: &[f64]| {
                        (0..x.len()).map(|i| scene.areas()[i] * (x[i] - y[i]).powi(2)).sum::<f64>().sqrt()
                    };
                    let distance = norm(&solved.radiosity, &exact) / norm(&solved.radiosity, &emission);
                    let estimate = solved.error_estimate;
                    // The estimate follows the residual through all bounces to 3 %, in the norm in which q bounds rho F:
                    // an error of the propagated residual of at most 3 % x (1 + q) / (1 - q). To it comes the kernels'
                    // share, the same for every tolerance; 1e-12 is the rounding of the exact solution.
                    let blur = 0.03 * (1.0 + q) / (1.0 - q) * distance + 1e-12;
                    let kernels = 1.1 * f.kernel_error() / (1.0 - q);
                    let context =
                        format!("{name}, {method_name}, band {b}, {tolerance:e}: {distance:e} and {estimate:e}");
                    assert!(estimate >= distance - blur, "{context}");
                    assert!(estimate <= distance + blur + kernels, "{context}");
                    checked += 1;
                }
            }
        }
    }
    assert_eq!(checked, 2 * 3 * (METHODS.len() - 1) * 4);
}

#[test]
fn the_error_estimate_of_a_furnace_in_closed_form() {
    // Kernels that are all off by d in the same direction make B = E / (1 - (1 + d) rho): off by d / (1 - rho) of B - E.
    for rho in [0.1, 0.5, 0.95] {
        let scene = cube(2).scene_with(1, Sides::Front, |_, _| rho, |_, _| 1.0);
        let f = dense(&scene, 1e-2, 0);
        let solved = run(&system(&f, &scene), Method::Direct, &options(1e-10)).unwrap();
        let expected = f.kernel_error() / (1.0 - rho);
        assert!(f.kernel_error() > 1e-5);
        // The estimate is propagated to 3 %, in one dimension here: a constant stays a constant up to the errors of F.
        assert_close(solved.error_estimate, expected, 0.04 * expected);
        assert!(solved.standard_error.is_none());
    }
}

/// By how much the spread of B over 16 seeds exceeds the standard error that is told, in a room of one reflectance; and the
/// same for the estimate in the norm.
fn spread_over_told(rho: f64) -> (f64, f64) {
    let scene = stack_in_box(1).scene_with(1, Sides::Front, |_, _| rho, |i, _| if i < 8 { 10.0 } else { 0.0 });
    let (mut all, mut told, mut estimated) = (Vec::new(), 0.0, 0.0);
    for seed in 0..16 {
        let f = dense(&scene, 1e-2, seed);
        let solved = run(&system(&f, &scene), Method::GaussSeidel, &options(1e-10)).unwrap();
        let reflected = distances(&scene, &solved.radiosity, scene.emission())[0];
        told += norms(&scene, &solved.standard_error.unwrap())[0].powi(2) / 16.0;
        estimated += (solved.error_estimate * reflected).powi(2) / 16.0;
        all.push(solved.radiosity);
    }
    let mut spread = 0.0;
    for i in 0..scene.len() {
        let mean = all.iter().map(|b| b[i]).sum::<f64>() / 16.0;
        spread += scene.areas()[i] * all.iter().map(|b| (b[i] - mean).powi(2)).sum::<f64>() / 15.0;
    }
    ((spread / told).sqrt(), (spread / estimated).sqrt())
}

#[test]
fn the_standard_error_of_a_solution_is_its_spread_over_seeds() {
    for rho in [0.2, 0.5, 0.8, 0.95] {
        let (error, estimate) = spread_over_told(rho);
        // In a dark room 52 patches with 15 degrees of freedom each fix the ratio to some 10 %. In a white one the error is
        // one number shared by all patches: 15 degrees of freedom for the spread, 18 %, and what is told rests on 16 x 4
        // draws.
        assert!((0.6..1.6).contains(&error), "rho {rho}: the spread is {error} times the standard error");
        // The estimate holds the kernels' bound besides, which is no spread: it may only be larger.
        assert!((0.3..1.6).contains(&estimate), "rho {rho}: the spread is {estimate} times the error estimate");
    }
}

#[test]
fn the_solution_of_sampled_factors_is_near_that_of_finer_ones() {
    let mesh = stack_in_box(1);
    let scene = mesh.scene_with(2, Sides::Front, |_, b| [0.3, 0.5][b], |i, b| if i % 6 == b { 1.0 } else { 0.0 });
    // Twenty times finer: its own error does not count.
    let reference = dense(&scene, 5e-4, 99);
    let exact = run(&system(&reference, &scene), Method::Direct, &options(1e-12)).unwrap().radiosity;
    for seed in 0..8 {
        let f = dense(&scene, 1e-2, seed);
        assert!(f.segments() > 0 && table(&f) != table(&reference));
        let solved = run(&system(&f, &scene), Method::Gmres, &options(1e-8)).unwrap();
        let reflected: Vec<f64> = solved.radiosity.iter().zip(scene.emission()).map(|(b, e)| b - e).collect();
        let distances = distances(&scene, &solved.radiosity, &exact);
        let worst = distances.iter().zip(norms(&scene, &reflected)).map(|(d, size)| d / size).fold(0.0, f64::max);
        // One standard error is told. A norm over 52 patches is seldom beyond two, and later bounces add up to
        // rho / (1 - rho) = 1 of it.
        assert!(worst < 4.0 * solved.error_estimate, "seed {seed}: {worst} against {}", solved.error_estimate);
        assert!(worst > 0.1 * solved.error_estimate, "seed {seed}: {worst} against {}", solved.error_estimate);
    }
}
