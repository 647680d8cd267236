//! How long does a cut take, from scratch and followed from view to view?

use std::time::Instant;

use crate::error::LodError;
use crate::job::Job;
use crate::lod::foliage_hierarchy::criteria::{Criterion, Placed};
use crate::lod::foliage_hierarchy::cut::{Cut, Rule, Steps, scratch};
use crate::lod::foliage_hierarchy::depth_first::DepthFirst;
use crate::lod::foliage_hierarchy::forest::Forest;
use crate::lod::foliage_hierarchy::zone::Zone;

/// One view of a walk.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct FrameTimes {
    /// Least time of all rounds that the cut took from scratch, in microseconds, with the criterion
    /// brought into the plant's space.
    pub scratch_micros: f64,
    /// The same, followed from the view before; the first view is followed from the roots.
    pub followed_micros: f64,
    /// Nodes of the list.
    pub active_count: usize,
    /// Entries of it that the followed cut wrote anew.
    pub dirty_count: usize,
    /// Nodes and balls that the cut from scratch asked.
    pub scratch_steps: Steps,
    /// What the followed cut did.
    pub followed_steps: Steps,
}

/// Walks along views `round_count` times, with both kinds of cut in turn.
///
/// # Errors
/// As [`Zone::new`]; [`LodError::Cancelled`].
pub fn walk(
    forest: &Forest,
    order: &DepthFirst,
    views: &[Placed<'_>],
    criterion: &Criterion,
    rule: Rule,
    round_count: usize,
    job: &Job,
) -> Result<Vec<FrameTimes>, LodError> {
    let mut frames: Vec<FrameTimes> = Vec::with_capacity(views.len());
    for round in 0..round_count.max(1) {
        let mut cut = Cut::new(forest, order);
        for (number, placed) in views.iter().enumerate() {
            job.check()?;
            let begin = Instant::now();
            let zone = Zone::new(criterion, forest, order, placed)?;
            let (active, scratch_steps) = scratch(order, &zone, rule);
            let scratch_micros = begin.elapsed().as_secs_f64() * 1e6;
            let begin = Instant::now();
            let zone = Zone::new(criterion, forest, order, placed)?;
            let followed_steps = cut.update(forest, order, zone, rule);
            let followed_micros = begin.elapsed().as_secs_f64() * 1e6;
            assert!(cut.active() == active, "a followed cut is that from scratch");
            let dirty = cut.changes().dirty.iter().map(|range| range.len()).sum();
            let frame = FrameTimes {
                scratch_micros,
                followed_micros,
                active_count: active.len(),
                dirty_count: dirty,
                scratch_steps,
                followed_steps,
            };
            if round == 0 {
                frames.push(frame);
            } else {
                let best = &mut frames[number];
                best.scratch_micros = best.scratch_micros.min(scratch_micros);
                best.followed_micros = best.followed_micros.min(followed_micros);
            }
        }
    }
    Ok(frames)
}

#[cfg(test)]
mod tests {
    use glam::{DAffine3, DVec3};

    use super::*;
    use crate::lod::foliage_hierarchy::made::chain;
    use crate::view::{Projection, View};

    #[test]
    fn a_walk_reports_each_view() {
        let forest = chain(100);
        let order = DepthFirst::new(&forest);
        let projection = Projection::Perspective { fov_y: 0.8 };
        let views: Vec<View> = [0.0, 50.0, 50.0]
            .map(|x| {
                let (eye, target) = (DVec3::new(x, 0.0, 5.0), DVec3::new(x, 0.0, 0.0));
                View::new(eye, target, DVec3::Y, projection, (64, 64), 0.01).expect("valid")
            })
            .into();
        let placed: Vec<Placed<'_>> = views
            .iter()
            .map(|view| Placed { view, world_from_local: DAffine3::IDENTITY })
            .collect();
        let criterion = Criterion::Distance { max_distance: 10.0 };
        let job = Job::default();
        let frames = walk(&forest, &order, &placed, &criterion, Rule::Inclusive, 2, &job);
        let frames = frames.expect("valid");
        assert_eq!(frames.len(), 3, "one a view");
        assert!(frames[1].active_count > 1, "something is near: {:?}", frames[1]);
        assert_eq!(frames[2].followed_steps, Steps::default(), "the view stays");
        assert_eq!(frames[2].dirty_count, 0, "the view stays");
        job.cancel();
        let stopped = walk(&forest, &order, &placed, &criterion, Rule::Inclusive, 1, &job);
        assert_eq!(stopped, Err(LodError::Cancelled), "stopped");
    }
}
