//! Chapter 4, what was before: clusters of patches that overlap, each with a matrix of its own (Martin 2010), beside
//! the matrix of all patches. The chapter says that light may have edges where clusters meet.

use glam::{Vec3, Vec4};
use localmatrix::LocalMatrix;
use multibounce::Channels;
use scene::math::luminance;
use serde::Serialize;
use transport::LinearOperator as _;

use super::matrix::{Subject, timed};
use super::{Outcome, Study};
use crate::error::Error;
use crate::progress::is_cancelled;
use crate::report::{Plot, Series, Table, significant};
use shell::operator_error::{exact_product, relative_error};

/// Clusters: parts of the scene, halved across their longest side.
const CLUSTERS: [usize; 4] = [1, 2, 4, 8];
/// Reach of a cluster beyond its own part, in shares of the longest side of the scene.
const OVERLAPS: [f32; 3] = [0.0, 0.1, 0.2];
/// Neighbours have normals with at least this cosine, and are at most so many times their edge apart.
const ALIKE: f32 = 0.9;
const NEAR: f32 = 2.0;

/// Clusters of one number and overlap.
#[derive(Serialize)]
struct Row {
    patches: usize,
    clusters: usize,
    overlap: f32,
    /// Patches of the largest cluster.
    largest: usize,
    /// Bytes of all matrices, over those of the matrix of all patches.
    bytes: f64,
    multiplications: f64,
    /// Processor seconds that the matrices took to make.
    made_s: f64,
    /// Error of the light of all patches beside that of the matrix of all.
    error: f64,
    /// Steps of the light over that of the matrix of all, between neighbours of two clusters: median, 95th percentile.
    step: f64,
    greatest_step: f64,
}

/// Edges of the light, bytes and work, over the number of clusters and their overlap.
pub(super) fn overlapping(study: &Study) -> Result<Outcome, Error> {
    let mut rows = Vec::new();
    for &count in &study.counts {
        let subject = Subject::new(study, count)?;
        let operators = subject.operators(None, study)?;
        let whole = exact_product(Channels::Three(operators.each_ref()), &subject.factors.area, &subject.light);
        for clusters in CLUSTERS {
            // One cluster has nothing to overlap with.
            for &overlap in if clusters == 1 { &OVERLAPS[..1] } else { &OVERLAPS[..] } {
                rows.push(measure(&subject, &whole, clusters, overlap)?);
                if is_cancelled() {
                    return Err(shell::Error::Cancelled.into());
                }
            }
        }
    }
    let last = study.counts.last().map_or(0, |_| rows[rows.len() - 1].patches);
    let plot = Plot {
        title: "Steps of the light where clusters meet".into(),
        unit: "%, 95th percentile".into(),
        x: "clusters".into(),
        logarithmic: false,
        series: OVERLAPS
            .map(|overlap| {
                let of = rows.iter().filter(|row| row.patches == last && row.clusters > 1 && row.overlap == overlap);
                let points = of.map(|row| (row.clusters as f64, 100.0 * row.greatest_step)).collect();
                Series { name: format!("overlap {overlap}"), points }
            })
            .into(),
    };
    Ok(Outcome {
        rows: serde_json::to_value(&rows).unwrap_or_default(),
        tables: vec![table(&rows)],
        plots: vec![("steps", plot)],
    })
}

/// A part of the scene: its bounds, and the patches whose centres are in it.
#[derive(Clone)]
struct Part {
    low: Vec3,
    high: Vec3,
    own: Vec<u32>,
}

impl Part {
    /// Halves with equally many patches, across the longest side.
    fn halves(mut self, centre: &[Vec3]) -> [Self; 2] {
        let axis = (self.high - self.low).max_position();
        self.own.sort_by(|&a, &b| centre[a as usize][axis].total_cmp(&centre[b as usize][axis]).then(a.cmp(&b)));
        let upper = self.own.split_off(self.own.len() / 2);
        let at = upper.first().map_or(self.high[axis], |&patch| centre[patch as usize][axis]);
        let mut low = self.low;
        let mut high = self.high;
        (low[axis], high[axis]) = (at, at);
        [Self { high, ..self.clone() }, Self { low, high: self.high, own: upper }]
    }

    /// Patches of the cluster: its own first, then those within a distance of its bounds.
    fn cluster(&self, centre: &[Vec3], reach: f32) -> Vec<u32> {
        let outside = |at: Vec3| at.distance(at.clamp(self.low, self.high));
        let is_own: Vec<bool> = self.own.iter().fold(vec![false; centre.len()], |mut is_own, &patch| {
            is_own[patch as usize] = true;
            is_own
        });
        let near = |&patch: &u32| !is_own[patch as usize] && reach > 0.0 && outside(centre[patch as usize]) <= reach;
        self.own.iter().copied().chain((0..centre.len() as u32).filter(near)).collect()
    }
}

fn measure(subject: &Subject, whole: &[Vec4], clusters: usize, overlap: f32) -> Result<Row, Error> {
    let Subject { bake, factors, light, .. } = subject;
    let patches = &bake.mesh().patches;
    let n = patches.len();
    let centre: Vec<Vec3> = patches.iter().map(|patch| patch.centroid).collect();
    let low = centre.iter().copied().fold(Vec3::MAX, Vec3::min);
    let high = centre.iter().copied().fold(Vec3::MIN, Vec3::max);
    let mut parts = vec![Part { low, high, own: (0..n as u32).collect() }];
    while parts.len() < clusters {
        parts = parts.into_iter().flat_map(|part| part.halves(&centre)).collect();
    }
    let form_factors = subject.rows();
    let mut found = vec![Vec4::ZERO; n];
    let mut part_of = vec![0; n];
    let mut largest = 0;
    let mut entries = 0;
    let mut multiplications = 0;
    let mut made_s = 0.0;
    for (number, part) in parts.iter().enumerate() {
        let members = part.cluster(&centre, overlap * (high - low).max_element());
        let (matrix, seconds) = timed(|| {
            let mut matrix = LocalMatrix::new(members.len())?;
            matrix.add(&subject.entering(&members, &form_factors))?;
            Ok(matrix)
        })?;
        let slots: Vec<u32> = members.iter().filter_map(|&patch| matrix.slot(patch)).collect();
        let mut sent = vec![Vec4::ZERO; members.len()];
        let mut here = vec![Vec4::ZERO; members.len()];
        members.iter().zip(&slots).for_each(|(&patch, &slot)| sent[slot as usize] = light[patch as usize]);
        matrix.apply(&sent, &mut here).map_err(patchlight::Error::from)?;
        for (&patch, &slot) in part.own.iter().zip(&slots) {
            found[patch as usize] = here[slot as usize];
            part_of[patch as usize] = number;
        }
        largest = largest.max(members.len());
        entries += members.len() * members.len();
        multiplications += 3 * part.own.len() * members.len();
        made_s += seconds;
    }
    let (step, greatest_step) = steps(subject, whole, &found, &part_of);
    let all = (n * n) as f64;
    Ok(Row {
        patches: n,
        clusters: parts.len(),
        overlap,
        largest,
        bytes: entries as f64 / all,
        multiplications: multiplications as f64 / (3.0 * all),
        made_s,
        error: relative_error(&found, whole, &factors.area),
        step,
        greatest_step,
    })
}

/// Steps between a patch and its nearest like neighbour of another part: the difference of light over that of the
/// matrix of all. Median and 95th percentile; 0 where no parts meet.
fn steps(subject: &Subject, whole: &[Vec4], found: &[Vec4], part_of: &[usize]) -> (f64, f64) {
    let patches = &subject.bake.mesh().patches;
    let ratio = |patch: usize| {
        let right = luminance(whole[patch].truncate());
        (right > 0.0).then(|| f64::from(luminance(found[patch].truncate()) / right))
    };
    let mut all: Vec<f64> = (0..patches.len())
        .filter_map(|i| {
            let reach = NEAR * subject.factors.area[i].sqrt();
            let away = |j: usize| patches[j].centroid.distance(patches[i].centroid);
            let nearest = (0..patches.len())
                .filter(|&j| part_of[j] != part_of[i] && patches[j].normal.dot(patches[i].normal) > ALIKE)
                .min_by(|&a, &b| away(a).total_cmp(&away(b)))?;
            if away(nearest) > reach {
                return None;
            }
            Some((ratio(i)? - ratio(nearest)?).abs())
        })
        .collect();
    all.sort_by(f64::total_cmp);
    let at = |share: f64| all.get((share * all.len() as f64) as usize).copied().unwrap_or(0.0);
    (at(0.5), at(0.95))
}

fn table(rows: &[Row]) -> Table {
    let percent = |share: f64| format!("{} %", significant(100.0 * share));
    let cells = |row: &Row| {
        vec![
            row.patches.to_string(),
            row.clusters.to_string(),
            format!("{}", row.overlap),
            row.largest.to_string(),
            percent(row.bytes),
            percent(row.multiplications),
            significant(row.made_s),
            percent(row.error),
            percent(row.step),
            percent(row.greatest_step),
        ]
    };
    let heads = [
        "patches",
        "clusters",
        "overlap",
        "in the largest",
        "bytes",
        "multiplications",
        "made in s",
        "error",
        "step between clusters",
        "95th percentile",
    ];
    Table {
        caption: "Clusters with matrices of all bounces of their own, beside the matrix of all patches: bytes and \
                  multiplications over those of it. Overlaps in longest sides of the scene. A step is the difference, \
                  between a patch and its neighbour of another cluster, of light over that of all patches."
            .into(),
        head: heads.map(str::to_owned).to_vec(),
        rows: rows.iter().map(cells).collect(),
    }
}
