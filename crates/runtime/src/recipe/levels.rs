//! Recipe of the light of a streamed world: from the slots of the matrix to its leaves as a camera sees them, near by
//! of their own nodes, further off of merged ones.
//!
//! A leaf is a patch of the world, a node a leaf or several of them merged, a slot a row of the matrix, which holds one
//! node. Nodes that are merged equally often are a level.

use std::sync::Arc;

use glam::{UVec2, Vec4};
use gpu_kernels::localmatrix::{MeanPass, ShowLeavesPass, SpreadPass};
use gpu_kernels::params::CountParams;
use localmatrix::LevelParams;
use patches::{EMPTY_CELL, Lookup, LookupParams, LookupPatch};
use scene::{Rgb, SurfacePoint};

use super::Tables;
use super::formfactor::Surfaces;
use crate::executor::{Executor, ExecutorError};
use crate::plan::{PassId, Plan, Slice};

/// Levels begin at multiples of this among the values: ranges of a buffer begin at multiples of 256 bytes.
const LEVEL_STEP: usize = 64;

/// A level of merged nodes.
pub struct Level {
    /// Lookups of its nodes outdoors and of those indoors, where there are any; they number all nodes of the level.
    pub lookups: [Option<Lookup>; 2],
    /// The nodes of the level below that each is merged of: first and end.
    pub children: Vec<UVec2>,
    /// Areas of the nodes, m².
    pub area: Vec<f32>,
}

/// The leaves of a world.
pub struct Leaves {
    /// Middle and unit normal of each; its patch is 0 outdoors and 1 indoors.
    pub points: Vec<SurfacePoint>,
    /// Areas, m².
    pub area: Vec<f32>,
    /// Irradiance from a constant sky, W/m², for each; empty where there is none.
    pub sky: Vec<Vec4>,
}

/// Leaves, and the levels above them, in tables for a device.
pub struct LevelTables {
    leaves: Vec<SurfacePoint>,
    sky: Vec<Vec4>,
    /// First value of each level, of the leaves first; and the number of values.
    first: Vec<usize>,
    counts: Vec<usize>,
    /// Areas of all values, and of the children of the nodes of each level.
    area: Vec<f32>,
    children: Vec<Vec<UVec2>>,
    /// Two of each level, in common tables.
    lookups: Vec<LookupParams>,
    cells: Vec<u32>,
    offsets: Vec<u32>,
    entries: Vec<LookupPatch>,
}

impl LevelTables {
    /// Puts the lookups of all levels together; the first level stands above the leaves.
    pub fn new(leaves: Leaves, levels: Vec<Level>) -> Self {
        let mut tables = Self {
            first: vec![0],
            counts: vec![leaves.points.len()],
            leaves: leaves.points,
            sky: leaves.sky,
            area: leaves.area,
            children: Vec::new(),
            lookups: Vec::new(),
            cells: Vec::new(),
            offsets: Vec::new(),
            entries: Vec::new(),
        };
        for level in levels {
            let first = tables.area.len().next_multiple_of(LEVEL_STEP);
            tables.area.resize(first, 0.0);
            tables.first.push(first);
            tables.counts.push(level.area.len());
            tables.area.extend(level.area);
            tables.children.push(level.children);
            level.lookups.into_iter().for_each(|lookup| tables.push(lookup, first));
        }
        tables
    }

    /// A lookup of a level whose values begin at `first_value`.
    fn push(&mut self, lookup: Option<Lookup>, first_value: usize) {
        let Some(lookup) = lookup else { return self.lookups.push(LookupParams::default()) };
        let first_cell = self.cells.len() as u32;
        self.lookups.push(LookupParams { count: lookup.values as u32, first_cell, ..lookup.params });
        let places = self.offsets.len() as u32;
        let entries = self.entries.len() as u32;
        self.cells.extend(lookup.cells.iter().map(|cell| cell & EMPTY_CELL | ((cell & !EMPTY_CELL) + places)));
        self.offsets.extend(lookup.offsets.iter().map(|offset| offset + entries));
        self.entries.extend(
            lookup.entries.iter().map(|entry| LookupPatch { patch: entry.patch + first_value as u32, ..*entry }),
        );
    }

    /// Number of leaves.
    pub fn leaves(&self) -> usize {
        self.leaves.len()
    }

    /// Levels above the leaves.
    pub fn levels(&self) -> usize {
        self.children.len()
    }

    /// Bytes of the tables.
    pub fn bytes(&self) -> u64 {
        let children: usize = self.children.iter().map(|level| size_of_val(&level[..])).sum();
        let leaves = size_of_val(&self.leaves[..]) + size_of_val(&self.sky[..]) + size_of_val(&self.area[..]);
        let lookups = size_of_val(&self.cells[..]) + size_of_val(&self.offsets[..]) + size_of_val(&self.entries[..]);
        (children + leaves + lookups) as u64
    }
}

/// The passes from the slots to the leaves.
pub struct LeafLight {
    slot_of: Slice<u32>,
    passes: Vec<PassId>,
    show: PassId,
}

impl LeafLight {
    /// Adds the passes: the irradiance of the slots and of the sky at each leaf, means over merged nodes, and of these
    /// what is shown, W/m². Shapes: `irradiance[slots]`; `shown` and `offset`, one a leaf or more.
    ///
    /// # Errors
    /// Buffers that are too short.
    pub fn new(
        plan: &mut Plan,
        tables: &mut Tables,
        levels: &Arc<LevelTables>,
        irradiance: Slice<Rgb>,
        [shown, offset]: [Slice<Rgb>; 2],
    ) -> Result<Self, ExecutorError> {
        const PASS: &str = "lookup";
        let leaves = levels.leaves.len();
        let count = leaves as u32;
        let slot_of = plan.array("slot of", leaves);
        let light: Slice<Rgb> = plan.array("level light", levels.area.len());
        let area = tables.part(plan, "level area", levels, |levels| &levels.area);
        let light_of = |level: usize| light.part(levels.first[level], levels.counts[level]);

        let from_slots = match levels.sky.is_empty() {
            true => light_of(0),
            false => plan.array("from slots", leaves),
        };
        let spread = SpreadPass { slot_of, irradiance, leaves: from_slots };
        let mut passes = vec![plan.add(PASS, &spread, &CountParams { count })?];
        if !levels.sky.is_empty() {
            let sum = Surfaces {
                count,
                albedo: tables.owned(plan, "ones", vec![Vec4::ONE; leaves]),
                source: tables.part(plan, "sky light", levels, |levels| &levels.sky),
                irradiance: from_slots,
                exitance: light_of(0),
            };
            passes.push(sum.bounce(plan, PASS)?);
        }
        for (below, children) in levels.children.iter().enumerate() {
            let count = CountParams { count: children.len() as u32 };
            let mean = MeanPass {
                runs: tables.owned(plan, "children", children.clone()),
                area: area.part(levels.first[below], levels.counts[below]),
                exitance: light_of(below),
                light: light_of(below + 1),
            };
            passes.push(plan.add(PASS, &mean, &count)?);
        }
        let bound = ShowLeavesPass {
            leaves: tables.part(plan, "leaves", levels, |levels| &levels.leaves),
            light,
            lookups: tables.part(plan, "level lookups", levels, |levels| &levels.lookups),
            cells: tables.part(plan, "level cells", levels, |levels| &levels.cells),
            offsets: tables.part(plan, "level offsets", levels, |levels| &levels.offsets),
            entries: tables.part(plan, "level entries", levels, |levels| &levels.entries),
            offset,
            shown,
        };
        let show = plan.add(PASS, &bound, &LevelParams { count, ..LevelParams::default() })?;
        passes.push(show);
        Ok(Self { slot_of, passes, show })
    }

    /// Puts the slot of each leaf's node on the device.
    ///
    /// # Errors
    /// Another number of leaves; what the device says.
    pub fn set_slots(&self, executor: &mut (dyn Executor + 'static), slot_of: &[u32]) -> Result<(), ExecutorError> {
        executor.upload(self.slot_of, slot_of)
    }

    /// Submits the passes.
    ///
    /// # Errors
    /// What the device says.
    pub fn submit(&self, executor: &mut (dyn Executor + 'static), params: &LevelParams) -> Result<(), ExecutorError> {
        executor.push(self.show, params)?;
        executor.submit_passes(&self.passes)
    }
}
