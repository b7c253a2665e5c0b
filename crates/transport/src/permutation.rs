//! Orders of rows and columns.

use alloc::vec;
use alloc::vec::Vec;

use glam::Vec4;

use crate::error::{Error, check_length};

/// An order of n things, and its inverse. For a square matrix it is that of the rows and of the
/// columns, so that the diagonal stays where it is.
#[derive(Clone, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct Permutation {
    #[cfg_attr(feature = "serde", serde(with = "scene::pod::table"))]
    order: Vec<u32>,
    #[cfg_attr(feature = "serde", serde(with = "scene::pod::table"))]
    place: Vec<u32>,
}

impl Permutation {
    /// The order that changes nothing.
    pub fn identity(n: usize) -> Self {
        let order: Vec<u32> = (0..n as u32).collect();
        Self { place: order.clone(), order }
    }

    /// An order by the old number of what comes to each new place.
    ///
    /// # Errors
    /// [`Error::Value`] names the first place whose number is too large or was there before;
    /// [`Error::TooMany`] beyond 2³² − 1 numbers.
    pub fn new(order: Vec<u32>) -> Result<Self, Error> {
        let n = order.len();
        if n >= u32::MAX as usize {
            let limit = u64::from(u32::MAX - 1);
            return Err(Error::TooMany { name: "order", found: n as u64, limit });
        }
        let mut place = vec![u32::MAX; n];
        for (new, &old) in order.iter().enumerate() {
            match place.get_mut(old as usize) {
                Some(slot) if *slot == u32::MAX => *slot = new as u32,
                _ => {
                    let rule = "smaller than their number and occur once";
                    let value = f64::from(old);
                    return Err(Error::Value { name: "order", index: new, value, rule });
                }
            }
        }
        Ok(Self { order, place })
    }

    /// Swaps what is at two places; both must be there.
    pub fn swap(&mut self, a: usize, b: usize) {
        self.order.swap(a, b);
        self.place[self.order[a] as usize] = a as u32;
        self.place[self.order[b] as usize] = b as u32;
    }

    /// Number of places.
    pub fn len(&self) -> usize {
        self.order.len()
    }

    /// True without places.
    pub fn is_empty(&self) -> bool {
        self.order.is_empty()
    }

    /// Old number of what is at each new place.
    pub fn order(&self) -> &[u32] {
        &self.order
    }

    /// New place of each old number.
    pub fn place(&self) -> &[u32] {
        &self.place
    }

    /// A vector by old numbers in the new order, `ordered[k] = values[order[k]]`.
    ///
    /// # Errors
    /// [`Error::Length`] unless both have one entry a place.
    pub fn apply(&self, values: &[Vec4], ordered: &mut [Vec4]) -> Result<(), Error> {
        gather(&self.order, values, ordered)
    }

    /// A vector in the new order by old numbers again, `values[i] = ordered[place[i]]`.
    ///
    /// # Errors
    /// [`Error::Length`] unless both have one entry a place.
    pub fn undo(&self, ordered: &[Vec4], values: &mut [Vec4]) -> Result<(), Error> {
        gather(&self.place, ordered, values)
    }
}

fn gather(from: &[u32], input: &[Vec4], output: &mut [Vec4]) -> Result<(), Error> {
    check_length("values", from.len(), input.len())?;
    check_length("ordered", from.len(), output.len())?;
    for (slot, &k) in output.iter_mut().zip(from) {
        *slot = input[k as usize];
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_way_back_leads_to_the_start() {
        let order = Permutation::new(vec![3, 0, 4, 1, 2]).unwrap();
        let values: Vec<Vec4> = (0..5).map(|k| Vec4::splat(k as f32)).collect();
        let mut ordered = vec![Vec4::ZERO; 5];
        let mut back = vec![Vec4::ZERO; 5];
        order.apply(&values, &mut ordered).unwrap();
        assert_eq!(ordered[0].x, 3.0);
        order.undo(&ordered, &mut back).unwrap();
        assert_eq!(back, values);
        order.apply(&ordered, &mut back).unwrap();
        assert_ne!(back, values);
        assert!(matches!(order.apply(&values[..4], &mut back), Err(Error::Length { .. })));
    }

    #[test]
    fn what_is_no_permutation_is_refused() {
        assert!(matches!(Permutation::new(vec![0, 2]), Err(Error::Value { index: 1, .. })));
        assert!(matches!(Permutation::new(vec![1, 0, 1]), Err(Error::Value { index: 2, .. })));
        assert!(Permutation::new(vec![]).unwrap().is_empty());
    }
}
