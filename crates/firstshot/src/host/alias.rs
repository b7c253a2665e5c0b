//! Alias tables.

use alloc::vec::Vec;

#[cfg(not(feature = "std"))]
use num_traits::Float as _;

use transport::alias::pair_entries;

use crate::types::AliasEntry;

/// The alias table of entries with these weights ≥ 0 (Vose 1991), in O(n): a slot each, filled by its own entry up to
/// the threshold and by another above. Probabilities are exact to 2⁻³² of a slot. Empty where all weights are zero.
pub fn alias_table(weights: &[f64]) -> Vec<AliasEntry> {
    let total: f64 = weights.iter().sum();
    if total.is_nan() || total <= 0.0 {
        return Vec::new();
    }
    let scale = weights.len() as f64 / total;
    let mut share: Vec<f64> = weights.iter().map(|w| w * scale).collect();
    let mut table: Vec<AliasEntry> =
        (0..weights.len() as u32).map(|k| AliasEntry { threshold: u32::MAX, other: k }).collect();
    let left = pair_entries(&mut share, 1.0, 0..weights.len() as u32, |entry, kept, other| {
        table[entry as usize] = AliasEntry { threshold: (kept * 2f64.powi(32)) as u32, other };
    });
    // What rounding has left over is one whole slot; only an entry that has any weight may keep it.
    if let Some(heaviest) = (0..weights.len()).max_by(|&a, &b| weights[a].total_cmp(&weights[b])) {
        for k in left.into_iter().filter(|&k| weights[k as usize] <= 0.0) {
            table[k as usize] = AliasEntry { threshold: 0, other: heaviest as u32 };
        }
    }
    table
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::kernel::start::pick;

    #[test]
    fn every_entry_has_its_probability() {
        let weights: Vec<f64> = (0..97).map(|k| if k % 7 == 3 { 0.0 } else { f64::from(k * k % 31) }).collect();
        let table = alias_table(&weights);
        let n = weights.len() as u32;
        let total = weights.iter().sum::<f64>();
        // From the table itself, and by picks.
        let mut found = alloc::vec![0.0f64; weights.len()];
        for (k, entry) in table.iter().enumerate() {
            let own = f64::from(entry.threshold) / 2f64.powi(32);
            found[k] += own;
            found[entry.other as usize] += 1.0 - own;
        }
        let mut picked = alloc::vec![0u32; weights.len()];
        let picks = 1u32 << 20;
        (0..picks).for_each(|k| picked[pick(&table, n, k << 12) as usize] += 1);
        for k in 0..weights.len() {
            let expected = weights[k] / total;
            assert!((found[k] / f64::from(n) - expected).abs() < 1e-9, "{k}");
            assert!((f64::from(picked[k]) / f64::from(picks) - expected).abs() < 2e-4, "{k}");
            assert!(expected > 0.0 || picked[k] == 0, "{k} has no weight");
        }
    }

    #[test]
    fn no_weight_gives_no_table() {
        assert!(alias_table(&[]).is_empty() && alias_table(&[0.0, 0.0]).is_empty());
        assert_eq!(alias_table(&[3.0]), [AliasEntry { threshold: u32::MAX, other: 0 }]);
    }
}
