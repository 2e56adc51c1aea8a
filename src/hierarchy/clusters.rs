//! Which patches make which cluster.
//!
//! Halved from the top: first what faces different ways is parted, then what lies in different places. What lies in one plane stays
//! together longest: it is flat and cannot see itself.

use std::collections::HashMap;
use std::ops::Range;

use super::functions::{Moments, Place, place};
use crate::geometry::polygon::centre;
use crate::scene::Scene;

/// No node.
pub const NONE: u32 = u32::MAX;

/// Normals that vary more than this, 1 - |mean|^2, are parted before places are.
const FACING: f64 = 0.25;
/// Patches are in one plane when their normals agree to this, and their planes to this part of the scene's size.
pub(super) const SAME: f64 = 1e-7;
/// A node while the tree is planned.
pub(super) struct Draft {
    pub(super) parent: u32,
    pub(super) level: u32,
    pub(super) children: Range<u32>,
    pub(super) patches: Range<usize>,
}

/// Plans the clusters, sorting the patches.
pub(super) fn drafts(scene: &Scene, sorted: &mut [u32]) -> Vec<Draft> {
    let regions = regions(scene);
    let mut drafts = vec![Draft { parent: NONE, level: 0, children: 0..0, patches: 0..scene.len() }];
    let mut number = 0;
    while number < drafts.len() {
        let Draft { level, patches: Range { start, end }, .. } = drafts[number];
        if end - start > 1 {
            let middle = start + part(scene, &regions, &mut sorted[start..end]);
            let first = drafts.len() as u32;
            drafts[number].children = first..first + 2;
            for patches in [start..middle, middle..end] {
                drafts.push(Draft { parent: number as u32, level: level + 1, children: 0..0, patches });
            }
        }
        number += 1;
    }
    drafts
}

/// The patches that lie in one plane and face the same way.
struct Regions {
    /// The region of every patch.
    of: Vec<u32>,
    /// Mean position and normal of every region.
    places: Vec<Place>,
}

fn regions(scene: &Scene) -> Regions {
    let (low, high) =
        crate::visibility::body::extremes(scene.faces().iter().flatten().map(|&v| scene.vertices()[v as usize]));
    let (middle, size) = (0.5 * (low + high), (high - low).max_element().max(f64::MIN_POSITIVE));
    // Rounded: two that fall on either side of a step become two regions, which only costs a few links.
    let key = |i: usize| {
        let n = scene.normals()[i];
        let offset = n.dot(scene.triangle(i)[0] - middle) / size;
        [n.x, n.y, n.z, offset].map(|x| (x / SAME).round() as i64)
    };
    let mut known: HashMap<[i64; 4], u32> = HashMap::new();
    let (mut of, mut moments): (Vec<u32>, Vec<Moments>) = (Vec::new(), Vec::new());
    for i in 0..scene.len() {
        let region = *known.entry(key(i)).or_insert(moments.len() as u32);
        let own = Moments::of_patch(scene.areas()[i], centre(&scene.triangle(i)), scene.normals()[i]);
        if region as usize == moments.len() {
            moments.push(own);
        } else {
            let sum = Moments::of_all([&moments[region as usize], &own].into_iter());
            moments[region as usize] = sum;
        }
        of.push(region);
    }
    Regions { of, places: moments.iter().map(|m| m.mean).collect() }
}

/// Parts some patches in two; returns how many are in the first half.
fn part(scene: &Scene, regions: &Regions, patches: &mut [u32]) -> usize {
    let first = regions.of[patches[0] as usize];
    let is_flat = patches.iter().all(|&i| regions.of[i as usize] == first);
    let place_of = |i: u32| {
        let i = i as usize;
        if is_flat {
            place(centre(&scene.triangle(i)), scene.normals()[i])
        } else {
            regions.places[regions.of[i] as usize]
        }
    };
    let (mut low, mut high) = ([f64::INFINITY; 6], [f64::NEG_INFINITY; 6]);
    let (mut area, mut sum, mut squares) = (0.0, [0.0; 6], [0.0; 6]);
    for &i in patches.iter() {
        let (z, a) = (place_of(i), scene.areas()[i as usize]);
        area += a;
        for k in 0..6 {
            (low[k], high[k]) = (low[k].min(z[k]), high[k].max(z[k]));
            sum[k] += a * z[k];
            squares[k] += a * z[k] * z[k];
        }
    }
    let variance = |k: usize| squares[k] / area - (sum[k] / area).powi(2);
    let widest = |axes: Range<usize>, width: &dyn Fn(usize) -> f64| {
        axes.max_by(|a, b| width(*a).total_cmp(&width(*b))).unwrap_or(0)
    };
    let (axis, bound) = if !is_flat && (3..6).map(variance).sum::<f64>() > FACING {
        let axis = widest(3..6, &variance);
        (axis, sum[axis] / area)
    } else {
        let axis = widest(0..3, &|k| high[k] - low[k]);
        (axis, 0.5 * (low[axis] + high[axis]))
    };
    // By the region where two have one place, by the number where two patches have.
    let key = |i: u32| (place_of(i)[axis], regions.of[i as usize], i);
    let comes_first = |i: u32| key(i).0 < bound;
    let count = patches.iter().filter(|&&i| comes_first(i)).count();
    if 0 < count && count < patches.len() {
        patches.sort_by_key(|&i| !comes_first(i));
        return count;
    }
    patches.sort_by(|a, b| {
        let ((x, r, i), (y, s, j)) = (key(*a), key(*b));
        x.total_cmp(&y).then(r.cmp(&s)).then(i.cmp(&j))
    });
    let half = patches.len() / 2;
    if is_flat {
        return half;
    }
    // Not through a region.
    let region = |k: usize| regions.of[patches[k] as usize];
    (half..patches.len())
        .find(|&k| region(k) != region(k - 1))
        .or((1..half).rfind(|&k| region(k) != region(k - 1)))
        .unwrap_or(half)
}
