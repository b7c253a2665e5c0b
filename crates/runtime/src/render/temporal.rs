//! Rows that frames sample: between patches, and where it is asked for to facets and receivers.

use formfactor::{Csr, HitRows, Operator as _};
use temporal::{AliasTables, Distribution, Packing, RayLists, Settings};

use crate::error::Error;

/// Entries of a list that stands for a row of real numbers.
const LIST_ENTRIES: usize = 1024;

/// How rows between patches are kept.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum RowKind {
    /// Lists of columns, all entries alike: [`RayLists`].
    #[default]
    Lists,
    /// [`AliasTables`].
    Tables,
}

/// Which rows are sampled; the others are multiplied by.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Sampled {
    /// Those from patch to patch.
    #[default]
    Patches,
    /// Those to facets and receivers, too.
    All,
}

/// Settings of temporal radiosity.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Temporal {
    /// What a frame does.
    pub settings: Settings,
    /// How rows between patches are kept.
    pub rows: RowKind,
    /// Which rows are sampled.
    pub sampled: Sampled,
}

/// Rows that are sampled.
#[derive(Clone, Debug, PartialEq)]
pub enum Rows {
    /// Lists.
    Lists(RayLists),
    /// Tables.
    Tables(AliasTables),
}

impl Rows {
    /// Rows of form factors, kept as `kind` says.
    ///
    /// # Errors
    /// What the distributions refuse.
    pub fn new(factors: &Csr, kind: RowKind) -> Result<Self, Error> {
        let Csr { columns, row_start, column_index, values, .. } = factors;
        Ok(match kind {
            RowKind::Lists => Self::Lists(
                RayLists::from_rows(*columns, row_start, column_index, values, LIST_ENTRIES)
                    .map_err(Error::Temporal)?,
            ),
            RowKind::Tables => Self::Tables(
                AliasTables::from_rows(*columns, row_start, column_index, values, Packing::Stacks)
                    .map_err(Error::Temporal)?,
            ),
        })
    }

    /// Rows that are counts of hits, as lists of these.
    pub(crate) fn of_hits(rows: &HitRows) -> Result<Self, Error> {
        Ok(Self::Lists(RayLists::from_counts(rows.columns(), rows.scales(), |i| rows.row(i)).map_err(Error::Temporal)?))
    }

    /// The rows as they are sampled.
    pub fn distribution(&self) -> &dyn Distribution {
        match self {
            Self::Lists(lists) => lists,
            Self::Tables(tables) => tables,
        }
    }

    /// First entry of each row, and the end of the last.
    pub(crate) fn row_start(&self) -> &[u32] {
        match self {
            Self::Lists(lists) => lists.row_start(),
            Self::Tables(tables) => tables.row_start(),
        }
    }
}

/// What a frame samples.
#[derive(Clone, Debug)]
pub(crate) struct SampledRows {
    pub settings: Settings,
    /// From patch to patch; none where all bounces end at facets and receivers.
    pub patches: Option<Rows>,
    pub facets: Option<Rows>,
    pub receivers: Option<Rows>,
}

impl SampledRows {
    /// Bytes of each part that takes the place of another.
    pub fn bytes(&self) -> [Option<u64>; 3] {
        [&self.patches, &self.facets, &self.receivers].map(|rows| rows.as_ref().map(|rows| rows.distribution().bytes()))
    }
}
