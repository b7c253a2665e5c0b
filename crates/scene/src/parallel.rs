//! Loops of the host: rayon's over all cores with the feature `std`, the same names one after the other without it.
//! What a loop gives does not depend on which.

pub use p3_maybe_rayon::PARALLEL_ENABLED;
pub use p3_maybe_rayon::prelude::*;

/// Names of rayon's iterators that [`p3_maybe_rayon`] lacks without threads.
#[cfg(not(feature = "std"))]
pub trait SerialIterator: Iterator + Sized {
    /// The first value that is wanted.
    fn find_first(mut self, is_wanted: impl Fn(&Self::Item) -> bool) -> Option<Self::Item> {
        self.find(is_wanted)
    }

    /// The first value for which `make` returns something.
    fn find_map_first<T>(mut self, make: impl Fn(Self::Item) -> Option<T>) -> Option<T> {
        self.find_map(make)
    }

    /// All values in place of those of a list.
    fn collect_into_vec(self, list: &mut alloc::vec::Vec<Self::Item>) {
        list.clear();
        list.extend(self);
    }
}

#[cfg(not(feature = "std"))]
impl<I: Iterator> SerialIterator for I {}

/// Names of rayon's sorts.
#[cfg(not(feature = "std"))]
pub trait SerialSort<T> {
    /// [`slice::sort_unstable`].
    fn par_sort_unstable(&mut self)
    where
        T: Ord;

    /// [`slice::sort_unstable_by`].
    fn par_sort_unstable_by(&mut self, compare: impl Fn(&T, &T) -> core::cmp::Ordering);

    /// [`slice::sort_unstable_by_key`].
    fn par_sort_unstable_by_key<K: Ord>(&mut self, key: impl Fn(&T) -> K);
}

#[cfg(not(feature = "std"))]
impl<T> SerialSort<T> for [T] {
    fn par_sort_unstable(&mut self)
    where
        T: Ord,
    {
        self.sort_unstable();
    }

    fn par_sort_unstable_by(&mut self, compare: impl Fn(&T, &T) -> core::cmp::Ordering) {
        self.sort_unstable_by(compare);
    }

    fn par_sort_unstable_by_key<K: Ord>(&mut self, key: impl Fn(&T) -> K) {
        self.sort_unstable_by_key(key);
    }
}
