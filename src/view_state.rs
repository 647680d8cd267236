//! What one camera remembers between frames.
//!
//! It only makes the next frame quicker, or carries a budget: a fresh state and a used one give the
//! same list.

use std::any::{Any, TypeId};
use std::collections::BTreeMap;

/// Which placed copy a memory belongs to: the representation's place in its scene, the instance's
/// among that representation's transforms.
pub type Key = (u32, u32);

/// Memories of any type, one of each type for each placed copy.
#[derive(Debug, Default)]
pub struct ViewState {
    slots: BTreeMap<(Key, TypeId), Box<dyn Any + Send>>,
}

impl ViewState {
    /// The memory of a copy; a default one if it has none of this type.
    pub fn slot<T: Any + Send + Default>(&mut self, key: Key) -> &mut T {
        let slot = self.slots.entry((key, TypeId::of::<T>()));
        let slot = slot.or_insert_with(|| Box::new(T::default()));
        slot.downcast_mut().expect("kept under its type")
    }
}
