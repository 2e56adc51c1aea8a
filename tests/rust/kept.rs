//! Operators made again of what was kept of them: the same bits in all that a solver asks, and refusal of what cannot be.

use radiosity::Progress;
use radiosity::assembly::matrix::Compressed;
use radiosity::assembly::{
    Dense, Estimator, FormFactors, KeptDense, KeptSampled, Numbers, Pattern, Sampled, SampledOptions, Uncertain,
    Uncertainty,
};
use radiosity::hierarchy::link::{Found, NO_MATRIX};
use radiosity::hierarchy::{HierarchicalOptions, Links, Reached, form_factors, from_kept};
use radiosity::scene::Scene;

use crate::common::{Mesh, PLENTY, Random, box_from, box_in_box, cube, dense, invalid, table, vec3};

/// Everything that a solver may ask, bit for bit.
fn assert_same(one: &dyn FormFactors, other: &dyn FormFactors) {
    let random = Random::new(7);
    let x: Vec<f64> = (0..2 * one.len()).map(|_| random.uniform()).collect();
    let answers = |f: &dyn FormFactors| {
        let mut product = vec![0.0; x.len()];
        f.apply(&x, 2, &mut product);
        let mut gathered = [0.0; 2];
        f.gather(3, &x, &mut gathered);
        let mut shot = vec![0.0; x.len()];
        f.shoot(3, &[1.0, 2.0], &mut shot);
        let errors = [f.standard_error(&x, 2), f.sampling_error(&x, 2, 5)].map(Option::unwrap_or_default);
        [table(f), product, gathered.to_vec(), shot, errors.concat(), vec![f.kernel_error(), f.nbytes() as f64]]
            .concat()
    };
    let bits = |f: &dyn FormFactors| answers(f).into_iter().map(f64::to_bits).collect::<Vec<u64>>();
    assert_eq!(bits(one), bits(other));
}

#[test]
fn a_dense_operator_comes_back() {
    let scene = box_in_box(2).scene();
    let f = dense(&scene, 0.02, 3);
    let kept = f.kept().clone();
    assert!(!kept.uncertain.is_empty());
    let again = Dense::from_kept(&scene, KeptDense { exchange: Numbers::of(kept.exchange.to_vec()), ..kept.clone() });
    assert_same(&again.unwrap(), &f);

    let refused = |kept: KeptDense| invalid(Dense::from_kept(&scene, kept));
    let short = Numbers::of(kept.exchange[1..].to_vec());
    assert!(refused(KeptDense { exchange: short, ..kept.clone() }).contains("entries, not"));
    let n = scene.len() as u32;
    for (i, j, standard_error) in [(n, 0, 0.1), (3, 3, 0.1), (3, 4, 0.1), (4, 3, -0.1), (4, 3, f64::NAN)] {
        let uncertain = vec![Uncertain { i, j, standard_error }];
        assert!(refused(KeptDense { uncertain, ..kept.clone() }).contains("uncertain pair 0"));
    }
    for error in [-1.0, f64::NAN, f64::INFINITY] {
        assert!(refused(KeptDense { kernel_error: error, ..kept.clone() }).contains("not both numbers from 0"));
        assert!(refused(KeptDense { error_estimate: error, ..kept.clone() }).contains("not both numbers from 0"));
    }
    assert!(invalid(Dense::from_kept(&cube(2).scene(), kept)).contains("is not that of 48"));
}

/// Nine houses of three heights, half a metre apart: few pairs of patches see each other.
fn town() -> Mesh {
    (0..9).fold(Mesh::default(), |mesh, k| {
        let low = vec3(1.5 * f64::from(k % 3), 1.5 * f64::from(k / 3), 0.0);
        mesh.and(&box_from(low, low + vec3(1.0, 1.0, f64::from(1 + k % 3)), 2).reversed())
    })
}

#[test]
fn a_dense_operator_of_few_entries_comes_back() {
    let scene = town().scene();
    let n = scene.len();
    let f = dense(&scene, 0.05, 3);
    let kept = f.kept().clone();
    assert!(!kept.uncertain.is_empty());
    let (start, column) = kept.pattern.entries().unwrap();
    assert_eq!((start.len(), column.len()), (n + 1, kept.exchange.len()));
    let again = |start: Vec<usize>, column: Vec<u32>| Pattern::from_entries(n, start, column);
    let pattern = again(start.to_vec(), column.to_vec()).unwrap();
    assert_same(&Dense::from_kept(&scene, KeptDense { pattern, ..kept.clone() }).unwrap(), &f);

    let whole = Dense::from_kept(&scene, KeptDense { pattern: Pattern::whole(n), ..kept.clone() });
    assert!(invalid(whole).contains("entries, not"));
    // A row that has two columns, and is not the last.
    let row = (0..n).find(|&i| start[i + 1] - start[i] > 1).unwrap();
    type Edit<'a> = &'a dyn Fn(&mut Vec<usize>);
    let edits: [Edit<'_>; 6] = [
        &|start| start[0] = 1,
        &|start| start[row] = usize::MAX,
        &|start| start[n] -= 1,
        &|start| start[n] += 1,
        &|start| start.truncate(n),
        &Vec::clear,
    ];
    for edit in edits {
        let mut start = start.to_vec();
        edit(&mut start);
        assert!(invalid(again(start, column.to_vec())).contains("do not ascend from 0 to"));
    }
    let first = start[row];
    for (place, j) in [(first, column[first + 1]), (start[row + 1] - 1, row as u32), (first, u32::MAX)] {
        let mut column = column.to_vec();
        column[place] = j;
        assert!(invalid(again(start.to_vec(), column)).contains(&format!("row {row}: its columns")));
    }
}

#[test]
fn sampled_operators_come_back() {
    let scene = box_in_box(1).scene();
    for estimator in [Estimator::MonteCarlo, Estimator::Hemicube] {
        let options = SampledOptions { tolerance: 0.3, seed: 3, memory: PLENTY };
        let f = Sampled::new(&scene, estimator, options, &Progress::default()).unwrap();
        let kept = f.kept().clone();
        let (start, index, value) = kept.rows.parts();
        let square = |index: Vec<u32>| Compressed::square(start.to_vec(), index, value.to_vec());
        let rows = square(index.to_vec()).unwrap();
        assert_same(&Sampled::from_kept(&scene, KeptSampled { rows, ..kept.clone() }).unwrap(), &f);

        let refused = |kept: KeptSampled| invalid(Sampled::from_kept(&scene, kept));
        let (n, k) = (scene.len(), index.len());
        let none = [
            Uncertainty::Rays(vec![1; n - 1]),
            Uncertainty::Rays(vec![0; n]),
            Uncertainty::Entries(vec![0.1; k + 1]),
            Uncertainty::Entries(vec![-0.1; k]),
            Uncertainty::Entries(vec![f64::NAN; k]),
        ];
        for uncertainty in none {
            assert!(refused(KeptSampled { uncertainty, ..kept.clone() }).contains("are not those of this matrix"));
        }
        assert!(invalid(square([&[n as u32], &index[1..]].concat())).contains("square matrix in CSR form"));
        assert!(invalid(Sampled::from_kept(&cube(2).scene(), kept)).contains("rows are not those of"));
    }
}

fn links(scene: &Scene) -> (Links, Reached) {
    let options = HierarchicalOptions { tolerance: 0.3, seed: 3, memory: PLENTY };
    form_factors(scene, &options, &Progress::default()).unwrap()
}

#[test]
fn links_come_back() {
    let scene = box_in_box(3).scene();
    let (f, reached) = links(&scene);
    let mark = f.tree_mark();
    assert_same(&from_kept(&scene, f.found.clone(), mark, &reached).unwrap(), &f);

    let refused = |change: &dyn Fn(&mut Found)| {
        let mut found = f.found.clone();
        change(&mut found);
        invalid(from_kept(&scene, found, mark, &reached))
    };
    let carries = f.found.links.iter().position(|link| link.at != NO_MATRIX).unwrap();
    assert!(refused(&|found| found.links[0].p = u32::MAX).contains("link 0 is of the nodes 4294967295"));
    for at in [f.found.matrices.len(), NO_MATRIX - 1] {
        assert!(refused(&|found| found.links[carries].at = at).contains("has no matrix of"));
    }
    assert!(refused(&|found| found.links[2].exchange.unoccluded = f64::NAN).contains("link 2 has an exchange"));
    assert!(refused(&|found| found.matrices[5] = f64::INFINITY).contains("not all finite"));
    let nowhere = Reached { error_estimate: f64::NAN, ..reached };
    assert!(invalid(from_kept(&scene, f.found.clone(), mark, &nowhere)).contains("not all finite"));
    assert!(invalid(from_kept(&scene, f.found.clone(), mark ^ 1, &reached)).contains("does not come out as it was"));
}

#[test]
fn another_tree_has_another_mark() {
    let mark = |scene: &Scene| links(scene).0.tree_mark();
    let room = box_in_box(2);
    assert_eq!(mark(&room.scene()), mark(&room.clone().scene()));
    assert_ne!(mark(&room.scene()), mark(&room.map(|x| 1.5 * x).scene()));
}
