//! Collapsing by looking at every pair in every step: the reference for the fast search, and a row of
//! the benchmark. O(n^3).

use glam::Vec3;

use crate::error::LodError;
use crate::job::Job;
use crate::lod::foliage_hierarchy::active_tree::Pair;
use crate::lod::foliage_hierarchy::collapse::{CollapseParams, Collapsed, Work};

/// The same as [`collapse`](crate::lod::foliage_hierarchy::collapse::collapse), slowly.
///
/// # Errors
/// As the fast one.
pub fn collapse_naive(
    quads: &[[Vec3; 4]],
    areas: &[f64],
    params: &CollapseParams,
    job: &Job,
) -> Result<Collapsed, LodError> {
    let mut work = Work::new(quads, areas, params, job)?;
    let steps = quads.len().saturating_sub(params.target_leaf_count);
    job.begin(steps as u64);
    let mut active: Vec<u32> = (0..work.forest.leaf_count).collect();
    let mut cost_count = 0;
    while work.forest.costs.len() < steps {
        let mut best: Option<Pair> = None;
        for (place, &low) in active.iter().enumerate() {
            job.check()?;
            for &high in &active[place + 1..] {
                cost_count += 1;
                let cost = work.cost(low, high);
                // indices rise, so that of equals the first is kept
                if cost <= params.max_cost && best.is_none_or(|known| cost < known.cost) {
                    best = Some(Pair { cost, low, high });
                }
            }
        }
        let Some(pair) = best else { break };
        let node = work.collapse(pair);
        active.retain(|&other| other != pair.low && other != pair.high);
        active.push(node);
        job.advance();
    }
    Ok(Collapsed { forest: work.forest, rule: work.rule, cost_count })
}
