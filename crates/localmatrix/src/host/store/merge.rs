//! Parts into a whole, and rows of children into those of their parents.

use std::collections::BTreeMap;
use std::path::Path;
use std::string::ToString;
use std::vec::Vec;

use super::error::BakeError;
use super::file::BakeFile;
use super::format::{LitPoint, Part, Record, WorldHead, block_range};
use super::write::BakeWriter;
use crate::host::world::{NO_NODE, Node};

/// The row of a node from those of its children: their mean by area, `F_P = Σ a_c F_c / Σ a_c` [T 5.2], its columns the
/// parents of theirs, with at most `most_points` of their points, each child's by its area.
pub fn parent_record(nodes: &[Node], parent: u32, children: &[Record], most_points: usize) -> Record {
    let node = &nodes[parent as usize];
    let own = node.first_child as usize..(node.first_child + node.children) as usize;
    let area: f64 = nodes[own.clone()].iter().map(|child| f64::from(child.area)).sum();
    let mut columns: BTreeMap<u32, f64> = BTreeMap::new();
    let mut sky = 0.0;
    let mut lost = 0.0;
    for (child, record) in nodes[own.clone()].iter().zip(children) {
        let share = f64::from(child.area) / area;
        sky += share * f64::from(record.sky);
        lost += share * f64::from(record.lost);
        for &(column, factor) in &record.factors {
            let above = nodes[column as usize].parent;
            *columns.entry(if above == NO_NODE { column } else { above }).or_default() += share * f64::from(factor);
        }
    }
    // Each point with the area that it stands for; those that stay are evenly spread over the area.
    let weighted: Vec<(f64, LitPoint)> = (nodes[own].iter().zip(children))
        .flat_map(|(child, record)| {
            let own_area = f64::from(child.area) / record.points.len().max(1) as f64;
            record.points.iter().map(move |point| (own_area, *point))
        })
        .collect();
    let total: f64 = weighted.iter().map(|one| one.0).sum();
    let count = most_points.min(weighted.len());
    let mut points = Vec::with_capacity(count);
    let mut passed = 0.0;
    for (own_area, point) in weighted {
        passed += own_area;
        while points.len() < count && total * (points.len() as f64 + 0.5) / count as f64 <= passed {
            points.push(point);
        }
    }
    let factors = columns.into_iter().map(|(column, factor)| (column, factor as f32)).collect();
    Record { sky: sky as f32, lost: lost as f32, factors, points }
}

/// Begins the whole bake of parts: all their blocks are in it, and only those of parents are missing. `progress(done,
/// all)` is called after each block.
///
/// # Errors
/// [`BakeError::Kind`], [`BakeError::OtherPart`], [`BakeError::DoubledPart`], [`BakeError::MissingParts`], and what is
/// wrong with a part's blocks.
pub fn join(path: &Path, parts: &[BakeFile], progress: &mut dyn FnMut(u32, u32)) -> Result<BakeWriter, BakeError> {
    let mut by_number: BTreeMap<u32, &BakeFile> = BTreeMap::new();
    let name = |file: &BakeFile| file.path().display().to_string();
    let Some(first) = parts.first() else { return Err(BakeError::MissingParts { parts: 1, missing: vec![1] }) };
    let mut all = 0;
    for file in parts {
        let Some(Part { number, of }) = file.head.part else {
            return Err(BakeError::Kind { path: name(file), found: "a whole bake".to_string(), expected: "a part" });
        };
        let other = |what| Err(BakeError::OtherPart { path: name(file), what, first: name(first) });
        if file.head.scene != first.head.scene {
            return other("another scene");
        }
        if file.head.key != first.head.key || file.world != first.world {
            return other("other settings");
        }
        if first.head.part.is_some_and(|part| part.of != of) {
            return other("another number of parts");
        }
        all = of;
        if let Some(before) = by_number.insert(number, file) {
            return Err(BakeError::DoubledPart { path: name(file), first: name(before), part: number });
        }
    }
    let missing: Vec<u32> = (1..=all).filter(|number| !by_number.contains_key(number)).collect();
    if !missing.is_empty() {
        return Err(BakeError::MissingParts { parts: all, missing });
    }
    let head = WorldHead { part: None, ..first.head };
    let begun = BakeWriter::resume(path, head.scene, head.key, None)?;
    let mut writer = match begun {
        Some(writer) => writer,
        None => BakeWriter::create(path, head, &first.text, first.nodes.clone(), first.extra.clone())?,
    };
    for file in by_number.values() {
        for block in file.head.own_blocks() {
            if writer.next_block() == Some(block) {
                writer.push_bytes(block, &file.read_block(block)?.0)?;
            }
            progress(block + 1, head.leaf_blocks());
        }
    }
    Ok(writer)
}

impl BakeWriter {
    /// Makes the rows of parents, once those of the leaves are there. `proceed(done, all)` is asked after each block;
    /// when it says no, what is there stays for another time.
    ///
    /// # Errors
    /// As [`BakeWriter::push`]; whether all were made.
    pub fn add_parents(
        &mut self,
        most_points: usize,
        proceed: &mut dyn FnMut(u32, u32) -> bool,
    ) -> Result<bool, BakeError> {
        let head = *self.head();
        // Children of successive parents follow each other: one block of them is read at a time.
        let mut held: Option<(u32, Vec<Record>)> = None;
        while let Some(block) = self.next_block() {
            let mut made: Vec<Record> = Vec::new();
            for parent in block_range(&head, block) {
                let node = self.nodes()[parent as usize];
                let mut children = Vec::with_capacity(node.children as usize);
                for child in node.first_child..node.first_child + node.children {
                    let from = head.block_of(child);
                    if from == block {
                        children.push(made[(child - block_range(&head, block).start) as usize].clone());
                        continue;
                    }
                    let records = match held.take() {
                        Some((number, records)) if number == from => records,
                        _ => self.records(from)?,
                    };
                    children.push(records[(child - block_range(&head, from).start) as usize].clone());
                    held = Some((from, records));
                }
                made.push(parent_record(self.nodes(), parent, &children, most_points));
            }
            self.push(&made)?;
            if !proceed(block + 1 - head.leaf_blocks(), head.blocks() - head.leaf_blocks()) {
                return Ok(self.next_block().is_none());
            }
        }
        Ok(true)
    }
}
