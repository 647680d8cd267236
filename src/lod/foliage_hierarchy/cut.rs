//! Detail where it is wanted: which nodes a crown consists of, given a zone of interest.
//!
//! A node is *needed finer* if it has children and it or any node below it is in the zone. Active are
//! the nodes that are not needed finer, and are roots or children of a node that is. By the paper's
//! rule only nodes below count, not the node itself. So every leaf has exactly one active node at or
//! above it, and the answer depends on the zone alone, not on what was active before: where the
//! paper's listing depends on the order in which it meets the nodes, this is the fixed point.
//!
//! [`scratch`] walks down from the roots. A sub-tree that is all in the zone is drawn by its leaves,
//! one that is not at all by its root, and only what may be either is entered. Each node is asked at
//! most once.
//!
//! [`Cut`] goes on from the last answer. It keeps for each sub-tree by how much the view may change
//! before anything in it can (see [`zone`](crate::lod::foliage_hierarchy::zone)), and enters only
//! those where that is used up; the others are passed as a block, whatever the number of active
//! nodes in them. So it need not traverse the list of active nodes, which in the paper takes the most
//! time. Only the edits of the list are in proportion to what changes, and the move of what lies
//! behind them, which is one copy.
//!
//! Neither depends on threads: there is one.
//!
//! This work is based on: I. Remolar, M. Chover, J. Ribelles, O. Belmonte. View-Dependent
//! Multiresolution Model for Foliage. Journal of WSCG 11(1), 2003.

use std::iter::Sum;
use std::ops::Add;

use crate::error::LodError;
use crate::lod::foliage_hierarchy::active::Changes;
use crate::lod::foliage_hierarchy::depth_first::DepthFirst;
use crate::lod::foliage_hierarchy::forest::{Forest, NONE};
use crate::lod::foliage_hierarchy::zone::{Below, Zone};

/// When a node is needed finer.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Rule {
    /// It or any node below it is in the zone.
    #[default]
    Inclusive,
    /// Any node below it is in the zone, as in the paper.
    Paper,
}

impl Rule {
    fn splits(self, is_fine_below: bool, is_fine: bool) -> bool {
        is_fine_below || (self == Self::Inclusive && is_fine)
    }
}

/// Work of an update, and what it did to the list.
///
/// Each inner node that was needed finer and is not any more is one collapse, each that was not and is
/// now one split. A list that grows by k nodes thus has k splits more than collapses.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Steps {
    /// Collapses of two nodes that both were active before: the paper's *collapse*.
    pub collapse_count: usize,
    /// Collapses of which at least one node first had to be made by another one: *`ForceCollapse`*.
    pub forced_collapse_count: usize,
    /// Splits of a node that was active before: the paper's *split*.
    pub split_count: usize,
    /// Splits of a node that another one had made: *`ForceSplit`*.
    pub forced_split_count: usize,
    /// Nodes asked whether they are in the zone.
    pub asked_node_count: usize,
    /// Sub-trees asked by their ball.
    pub asked_ball_count: usize,
    /// Sub-trees passed as a block because nothing can have changed in them.
    pub passed_count: usize,
}

impl Add for Steps {
    type Output = Self;

    fn add(self, other: Self) -> Self {
        Self {
            collapse_count: self.collapse_count + other.collapse_count,
            forced_collapse_count: self.forced_collapse_count + other.forced_collapse_count,
            split_count: self.split_count + other.split_count,
            forced_split_count: self.forced_split_count + other.forced_split_count,
            asked_node_count: self.asked_node_count + other.asked_node_count,
            asked_ball_count: self.asked_ball_count + other.asked_ball_count,
            passed_count: self.passed_count + other.passed_count,
        }
    }
}

impl Sum for Steps {
    fn sum<I: Iterator<Item = Self>>(steps: I) -> Self {
        steps.fold(Self::default(), Add::add)
    }
}

/// A node of whose sub-tree some part has been walked.
struct Begun {
    at: usize,
    first: usize,
    is_fine: bool,
}

/// Active nodes in depth-first order, from nothing but the zone; also how many nodes and balls were
/// asked.
pub fn scratch(order: &DepthFirst, zone: &Zone, rule: Rule) -> (Vec<u32>, Steps) {
    let mut active = Vec::new();
    let mut steps = Steps::default();
    let mut begun: Vec<Begun> = Vec::new();
    let mut at = 0;
    while at < order.places.len() {
        let place = &order.places[at];
        let end = place.end;
        let mut is_fine;
        if order.is_leaf(at) {
            steps.asked_node_count += 1;
            is_fine = zone.holds(at, place).0;
            active.push(place.node);
        } else {
            steps.asked_ball_count += 1;
            match zone.below(at, place).0 {
                Below::None => {
                    is_fine = false;
                    active.push(place.node);
                }
                Below::All => {
                    is_fine = true;
                    active.extend_from_slice(order.leaves_below(at));
                }
                Below::Maybe => {
                    begun.push(Begun { at, first: active.len(), is_fine: false });
                    at += 1;
                    continue;
                }
            }
        }
        // those that end here have had their last child
        while let Some(top) = begun.last_mut() {
            top.is_fine |= is_fine;
            let place = &order.places[top.at];
            if place.end != end {
                break;
            }
            if !top.is_fine {
                steps.asked_node_count += 1;
                is_fine = zone.holds(top.at, place).0;
                if !rule.splits(false, is_fine) {
                    active.truncate(top.first);
                    active.push(place.node);
                }
            } else {
                is_fine = true;
            }
            begun.pop();
        }
        at = end as usize;
    }
    (active, steps)
}

/// How a sub-tree is drawn.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Drawn {
    /// By its topmost node; nothing is known of what lies below.
    Whole,
    /// By its topmost node, all below having been asked.
    Joined,
    /// By its leaves; nothing else is known of what lies below.
    Leaves,
    /// As each of its topmost node's children says.
    Split,
}

/// What the last update found of a sub-tree.
#[derive(Debug, Clone, Copy)]
struct Memo {
    /// Sum of drifts up to which it holds.
    until: f64,
    /// Sum of drifts up to which its ball will say no more than maybe; only to save questions, so
    /// rounding does no harm.
    maybe_until: f32,
    /// Active nodes.
    count: u32,
    drawn: Drawn,
    /// Whether any of its nodes is in the zone.
    is_fine: bool,
}

/// What the old list and the memos say of the children of a node.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Known {
    /// They are in the old list as their memos say.
    Memos,
    /// All their leaves are in the old list; their memos are of some time before.
    Leaves,
    /// They are not in the old list, but their memos hold.
    Hidden,
    /// They are not in the old list, and their memos are of some time before.
    Nothing,
}

/// A node of whose sub-tree some part has been updated.
#[derive(Debug, Clone, Copy)]
struct Open {
    at: usize,
    /// How the old list has it, or `None` if it has a node above.
    old: Option<Drawn>,
    known: Known,
    maybe_until: f32,
    old_first: usize,
    edit_count: usize,
    inserted_count: usize,
    /// Of the children so far.
    found: Found,
}

/// What comes of a sub-tree.
enum Visit {
    /// All is known.
    Done(Found),
    /// Its nodes must be asked.
    Enter { maybe_until: f32 },
}

/// What an update finds of a sub-tree.
#[derive(Debug, Clone, Copy)]
struct Found {
    until: f64,
    count: u32,
    is_fine: bool,
}

/// Active nodes that follow a zone of interest from view to view.
#[derive(Debug, Clone)]
pub struct Cut {
    memos: Vec<Memo>,
    active: Vec<u32>,
    changes: Changes,
    /// What the memos were made for.
    last: Option<(Zone, Rule)>,
    /// Sum of drifts.
    now: f64,
    open: Vec<Open>,
}

impl Cut {
    /// Begins with the roots alone.
    pub fn new(forest: &Forest, order: &DepthFirst) -> Self {
        let unknown =
            Memo { until: 0.0, maybe_until: 0.0, count: 1, drawn: Drawn::Whole, is_fine: false };
        Self {
            memos: vec![unknown; order.places.len()],
            active: forest.roots().collect(),
            changes: Changes::default(),
            last: None,
            now: 0.0,
            open: Vec::new(),
        }
    }

    /// Active nodes, in depth-first order.
    pub fn active(&self) -> &[u32] {
        &self.active
    }

    /// What the last update changed.
    pub fn changes(&self) -> &Changes {
        &self.changes
    }

    /// Bytes of the list and of what is kept beside it.
    pub fn bytes(&self) -> u64 {
        (size_of_val(&self.memos[..]) + size_of_val(&self.active[..])) as u64
    }

    /// Goes on from any list instead of the last one, which must be one of whole levels: each leaf
    /// has exactly one node of it at or above itself, and they are in depth-first order.
    ///
    /// # Errors
    /// [`LodError::Invalid`] under `active` if it is not; the list is then as it was.
    pub fn set_active(&mut self, order: &DepthFirst, active: Vec<u32>) -> Result<(), LodError> {
        check_active(order, &active)?;
        let mut at = 0;
        let mut entry = 0;
        let mut above: Vec<(usize, usize)> = Vec::new();
        while at < order.places.len() {
            let place = &order.places[at];
            if active[entry] != place.node {
                above.push((at, entry));
                at += 1;
                continue;
            }
            self.memos[at] = Memo {
                until: 0.0,
                maybe_until: 0.0,
                count: 1,
                drawn: Drawn::Whole,
                is_fine: false,
            };
            entry += 1;
            while let Some(&(top, first)) = above.last()
                && order.places[top].end == place.end
            {
                let count = u32::try_from(entry - first).expect("fewer than nodes");
                self.memos[top] = Memo {
                    until: 0.0,
                    maybe_until: 0.0,
                    count,
                    drawn: Drawn::Split,
                    is_fine: true,
                };
                above.pop();
            }
            at = place.end as usize;
        }
        self.active = active;
        self.changes.clear();
        self.last = None;
        Ok(())
    }

    /// Follows the zone to another view, criterion or rule.
    pub fn update(&mut self, forest: &Forest, order: &DepthFirst, zone: Zone, rule: Rule) -> Steps {
        self.changes.clear();
        let drift = match &self.last {
            Some((last, last_rule)) if *last_rule == rule => zone.drift_from(last),
            _ => f64::INFINITY,
        };
        self.now += drift;
        // whether what was found before still is of use
        let is_known = self.now <= zone.longest_drift();
        if !is_known {
            self.now = 0.0;
        }
        let mut steps = Steps::default();
        if drift > 0.0 {
            steps = Walk { order, zone: &zone, rule, is_known, entry: 0, steps }.run(self);
            steps = self.counted(forest, steps);
            let Self { changes, active, .. } = self;
            changes.apply(active);
        }
        self.last = Some((zone, rule));
        steps
    }

    /// Adds what the edits stand for; before they are carried out.
    fn counted(&self, forest: &Forest, mut steps: Steps) -> Steps {
        let parent = |node: &u32| forest.nodes[*node as usize].parent;
        for edit in &self.changes.edits {
            let gone = &self.active[edit.old.start as usize..edit.old.end as usize];
            if let [_] = gone {
                let made = (edit.inserted.end - edit.inserted.start) as usize;
                steps.split_count += 1;
                steps.forced_split_count += made - 2;
            } else {
                // sisters follow one another if both are active
                let pairs = gone.windows(2);
                let sisters = pairs
                    .filter(|pair| parent(&pair[0]) == parent(&pair[1]) && parent(&pair[0]) != NONE)
                    .count();
                steps.collapse_count += sisters;
                steps.forced_collapse_count += gone.len() - 1 - sisters;
            }
        }
        steps
    }
}

/// Each leaf is below exactly one.
fn check_active(order: &DepthFirst, active: &[u32]) -> Result<(), LodError> {
    let invalid = |why: String| LodError::Invalid { name: "active", why };
    let mut next = 0;
    for &node in active {
        let Some(&place) = order.place_of.get(node as usize) else {
            let count = order.places.len();
            return Err(invalid(format!("node {node} is none of the forest's {count}")));
        };
        let place = &order.places[place as usize];
        if place.first_leaf as usize != next {
            return Err(invalid(format!("leaves before node {node} are not drawn exactly once")));
        }
        next += order.leaves_below(order.place_of[node as usize] as usize).len();
    }
    if next == order.leaves.len() {
        return Ok(());
    }
    Err(invalid(format!("{} leaves at the end are not drawn", order.leaves.len() - next)))
}

/// One update.
struct Walk<'a> {
    order: &'a DepthFirst,
    zone: &'a Zone,
    rule: Rule,
    is_known: bool,
    /// How much of the old list has been passed.
    entry: usize,
    steps: Steps,
}

impl Walk<'_> {
    fn run(mut self, cut: &mut Cut) -> Steps {
        let mut open = std::mem::take(&mut cut.open);
        let mut at = 0;
        while at < self.order.places.len() {
            let known = open.last().map_or(Known::Memos, |top| top.known);
            let mut found = match self.visit(cut, at, known) {
                Visit::Done(found) => found,
                Visit::Enter { maybe_until } => {
                    open.push(self.opened(cut, at, known, maybe_until));
                    at += 1;
                    continue;
                }
            };
            let end = self.order.places[at].end;
            while let Some(top) = open.last_mut() {
                top.found = top.found.with(found);
                if self.order.places[top.at].end != end {
                    break;
                }
                found = self.close(cut, *top);
                open.pop();
            }
            at = end as usize;
        }
        cut.open = open;
        self.steps
    }

    /// How the old list draws a sub-tree.
    fn old(&self, cut: &Cut, at: usize, known: Known) -> Option<Drawn> {
        match known {
            Known::Memos => Some(cut.memos[at].drawn),
            Known::Leaves if self.order.is_leaf(at) => Some(Drawn::Whole),
            Known::Leaves => Some(Drawn::Leaves),
            Known::Hidden | Known::Nothing => None,
        }
    }

    /// Answers for a sub-tree without entering it, if that is possible.
    fn visit(&mut self, cut: &mut Cut, at: usize, known: Known) -> Visit {
        let memo = cut.memos[at];
        let is_memo = self.is_known && matches!(known, Known::Memos | Known::Hidden);
        if is_memo && cut.now < memo.until {
            self.steps.passed_count += 1;
            if known == Known::Memos {
                self.entry += memo.count as usize;
            }
            let Memo { until, count, is_fine, .. } = memo;
            return Visit::Done(Found { until, count, is_fine });
        }
        if is_memo && cut.now < f64::from(memo.maybe_until) {
            return Visit::Enter { maybe_until: memo.maybe_until };
        }
        let place = &self.order.places[at];
        let old = self.old(cut, at, known);
        let (drawn, count, is_fine, margin);
        if self.order.is_leaf(at) {
            self.steps.asked_node_count += 1;
            (is_fine, margin) = self.zone.holds(at, place);
            (drawn, count) = (Drawn::Whole, 1);
            self.entry += usize::from(old.is_some());
        } else {
            self.steps.asked_ball_count += 1;
            let below;
            (below, margin) = self.zone.below(at, place);
            let old_count = self.old_count(cut, at, old);
            match below {
                #[expect(clippy::cast_possible_truncation, reason = "rounding does no harm")]
                Below::Maybe => return Visit::Enter { maybe_until: (cut.now + margin) as f32 },
                Below::None => {
                    (drawn, count, is_fine) = (Drawn::Whole, 1, false);
                    if matches!(old, Some(Drawn::Leaves | Drawn::Split)) {
                        cut.changes.replace(self.entry..self.entry + old_count, &[place.node]);
                    }
                    self.entry += old_count;
                }
                Below::All => {
                    let leaves = self.order.leaves_below(at);
                    drawn = Drawn::Leaves;
                    count = u32::try_from(leaves.len()).expect("fewer than nodes");
                    is_fine = true;
                    match old {
                        Some(Drawn::Whole | Drawn::Joined) => {
                            cut.changes.replace(self.entry..self.entry + 1, leaves);
                            self.entry += 1;
                        }
                        Some(Drawn::Split) => self.split_all(cut, at),
                        Some(Drawn::Leaves) => self.entry += old_count,
                        None => {}
                    }
                }
            }
        }
        let until = cut.now + margin;
        cut.memos[at] = Memo { until, maybe_until: 0.0, count, drawn, is_fine };
        Visit::Done(Found { until, count, is_fine })
    }

    fn old_count(&self, cut: &Cut, at: usize, old: Option<Drawn>) -> usize {
        match old {
            None => 0,
            Some(Drawn::Whole | Drawn::Joined) => 1,
            Some(Drawn::Leaves) => self.order.leaves_below(at).len(),
            Some(Drawn::Split) => cut.memos[at].count as usize,
        }
    }

    /// Edits a sub-tree, as the memos have it, to its leaves.
    fn split_all(&mut self, cut: &mut Cut, top: usize) {
        let (mut at, end) = (top, self.order.places[top].end as usize);
        while at < end {
            match cut.memos[at].drawn {
                Drawn::Split => {
                    at += 1;
                    continue;
                }
                Drawn::Leaves => self.entry += self.order.leaves_below(at).len(),
                Drawn::Whole | Drawn::Joined => {
                    if !self.order.is_leaf(at) {
                        let leaves = self.order.leaves_below(at);
                        cut.changes.replace(self.entry..self.entry + 1, leaves);
                    }
                    self.entry += 1;
                }
            }
            at = self.order.places[at].end as usize;
        }
    }

    /// A sub-tree that must be entered.
    fn opened(&self, cut: &Cut, at: usize, known: Known, maybe_until: f32) -> Open {
        let old = self.old(cut, at, known);
        let below = match (old, cut.memos[at].drawn) {
            (Some(Drawn::Split), _) => Known::Memos,
            (Some(Drawn::Leaves), _) => Known::Leaves,
            (Some(Drawn::Joined), _) => Known::Hidden,
            (Some(Drawn::Whole), _) => Known::Nothing,
            (None, Drawn::Split | Drawn::Joined) if known == Known::Hidden => Known::Hidden,
            (None, _) => Known::Nothing,
        };
        Open {
            at,
            old,
            known: below,
            maybe_until,
            old_first: self.entry,
            edit_count: cut.changes.edits.len(),
            inserted_count: cut.changes.inserted.len(),
            found: Found { until: f64::INFINITY, count: 0, is_fine: false },
        }
    }

    /// After both children.
    fn close(&mut self, cut: &mut Cut, open: Open) -> Found {
        let Open { at, old, mut found, .. } = open;
        let place = &self.order.places[at];
        let is_fine_below = found.is_fine;
        if !is_fine_below {
            self.steps.asked_node_count += 1;
            let (is_fine, margin) = self.zone.holds(at, place);
            found.until = found.until.min(cut.now + margin);
            found.is_fine = is_fine;
        }
        let is_split = self.rule.splits(is_fine_below, found.is_fine);
        let was_split = matches!(old, Some(Drawn::Split | Drawn::Leaves));
        if !is_split {
            found.count = 1;
        }
        let drawn = if is_split { Drawn::Split } else { Drawn::Joined };
        let Found { until, count, is_fine } = found;
        cut.memos[at] = Memo { until, maybe_until: open.maybe_until, count, drawn, is_fine };
        if old.is_some() && !was_split {
            self.entry = open.old_first + 1;
            if is_split {
                let start = cut.changes.inserted.len();
                self.emit(cut, at);
                cut.changes.push(open.old_first..self.entry, start);
            }
        } else if was_split && !is_split {
            cut.changes.edits.truncate(open.edit_count);
            cut.changes.inserted.truncate(open.inserted_count);
            cut.changes.replace(open.old_first..self.entry, &[place.node]);
        }
        found
    }

    /// Inserts a sub-tree as the memos have it.
    fn emit(&self, cut: &mut Cut, top: usize) {
        let inserted = &mut cut.changes.inserted;
        let (mut at, end) = (top, self.order.places[top].end as usize);
        while at < end {
            let place = &self.order.places[at];
            match cut.memos[at].drawn {
                Drawn::Split => {
                    at += 1;
                    continue;
                }
                Drawn::Leaves => inserted.extend_from_slice(self.order.leaves_below(at)),
                Drawn::Whole | Drawn::Joined => inserted.push(place.node),
            }
            at = place.end as usize;
        }
    }
}

impl Found {
    /// Together with the next child.
    fn with(self, next: Self) -> Self {
        Self {
            until: self.until.min(next.until),
            count: self.count + next.count,
            is_fine: self.is_fine | next.is_fine,
        }
    }
}

#[cfg(test)]
mod tests;
