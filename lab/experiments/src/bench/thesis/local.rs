//! Figure 4.12: the whole matrix beside the local one, as printed and ours, for a camera that moves.

use std::collections::{BTreeSet, HashSet};

use glam::{Vec3, Vec4};
use localmatrix::{LocalMatrix, choose};
use multibounce::Channels;
use printed::PrintedMatrix;
use scene::kernel::camera::{primary_direction, primary_hit};
use scene::{Camera, NONE};
use serde::Serialize;

use super::matrix::{Subject, timed};
use super::{Outcome, Study};
use crate::args::CameraPath;
use crate::error::Error;
use crate::progress::is_cancelled;
use crate::report::{Plot, Series, Table, significant};
use shell::operator_error::{exact_product, relative_error};

/// Patches in the matrix.
const SLOTS: usize = 256;
/// Frames of the path, patches that may enter in each, and how much nearer those count that are there.
const FRAMES: u32 = 48;
const BUDGET: usize = 32;
const HYSTERESIS: f32 = 0.1;
/// Pixels whose rays say what is visible.
const PIXELS: (u32, u32) = (96, 54);

/// Work of a frame, on average.
#[derive(Serialize)]
struct Row {
    patches: usize,
    slots: usize,
    /// Patches that entered in all frames but the first.
    entered: usize,
    /// Mean share of the slots that is visible, and that is lit.
    visible: f64,
    lit: f64,
    whole: Work,
    printed: Work,
    exact: Work,
    /// Greatest relative error of the light of visible patches: beside all patches exactly.
    printed_error: f64,
    exact_error: f64,
    /// Drift of the printed matrix beside the exact one of the same patches: its first and its last frame.
    first_drift: f64,
    last_drift: f64,
}

/// Work of a frame: multiplications, and processor milliseconds, of changes and products.
#[derive(Clone, Copy, Default, Serialize)]
struct Work {
    multiplications: f64,
    ms: f64,
}

impl Work {
    fn add(&mut self, multiplications: u64, seconds: f64) {
        self.multiplications += multiplications as f64 / f64::from(FRAMES - 1);
        self.ms += 1e3 * seconds / f64::from(FRAMES - 1);
    }
}

/// Figure 4.12, and the curve of P_Vis × P_Lit.
pub(super) fn figure(study: &Study) -> Result<Outcome, Error> {
    let mut rows = Vec::new();
    let mut shares = Vec::new();
    for &count in &study.counts {
        let subject = Subject::new(study, count)?;
        let (row, of_frames) = fly(study, &subject)?;
        rows.push(row);
        shares = of_frames;
    }
    let series = |name: &str, of: &dyn Fn(&Row) -> f64| Series {
        name: name.into(),
        points: rows.iter().map(|row| (row.patches as f64, of(row))).collect(),
    };
    let plot = |title: &str, unit: &str, of: fn(&Work) -> f64| Plot {
        title: title.into(),
        unit: unit.into(),
        x: "patches".into(),
        logarithmic: true,
        series: vec![
            series("whole matrix", &|row| of(&row.whole)),
            series("local, as printed", &|row| of(&row.printed)),
            series("local, ours", &|row| of(&row.exact)),
        ],
    };
    let visible = Plot {
        title: "Part of the local matrix that is multiplied".into(),
        unit: "%".into(),
        x: "frame".into(),
        logarithmic: false,
        series: vec![
            Series { name: "visible".into(), points: points(&shares, |share| share.0) },
            Series { name: "lit".into(), points: points(&shares, |share| share.1) },
            Series { name: "visible × lit".into(), points: points(&shares, |share| share.0 * share.1) },
        ],
    };
    Ok(Outcome {
        rows: serde_json::to_value(&rows).unwrap_or_default(),
        tables: vec![table(&rows)],
        plots: vec![
            ("time", plot("A frame", "ms", |work| work.ms)),
            ("work", plot("A frame", "multiplications", |work| work.multiplications)),
            ("visible", visible),
        ],
    })
}

fn points(shares: &[(f64, f64)], of: fn(&(f64, f64)) -> f64) -> Vec<(f64, f64)> {
    shares.iter().enumerate().map(|(frame, share)| (frame as f64, 100.0 * of(share))).collect()
}

/// The frames of a path; shares of the slots that are visible and lit in each.
fn fly(study: &Study, subject: &Subject) -> Result<(Row, Vec<(f64, f64)>), Error> {
    let factors = &subject.factors;
    let light = &subject.light;
    let n = subject.bake.mesh().patches.len();
    let operators = subject.operators(None, study)?;
    let all = Channels::Three(operators.each_ref());
    let (whole_light, whole_s) = timed(|| Ok(exact_product(all, &factors.area, light)))?;
    let mut flight = Flight::new(subject, SLOTS)?;
    let mut row = Row {
        patches: n,
        slots: flight.slots,
        entered: 0,
        visible: 0.0,
        lit: 0.0,
        whole: Work { multiplications: 3.0 * (n * n) as f64, ms: 1e3 * whole_s },
        printed: Work::default(),
        exact: Work::default(),
        printed_error: 0.0,
        exact_error: 0.0,
        first_drift: 0.0,
        last_drift: 0.0,
    };
    let path = CameraPath::Fly.animation(study.loaded);
    let mut shares = Vec::new();
    for frame in 0..FRAMES {
        let view = path.at(path.duration() * frame as f32 / (FRAMES - 1) as f32).1;
        // The first frame makes all ready.
        let changed = flight.change(view.eye, if frame == 0 { flight.slots } else { BUDGET })?;
        let seen = flight.those_of(&visible(study, subject, &view.camera(PIXELS.0, PIXELS.1)));
        let lit = flight.lit(light);
        let (printed, exact) = flight.products(&Places { seen: &seen, lit: &lit, light })?;
        let at = |values: &[Vec4]| seen.iter().map(|&patch| values[patch as usize]).collect::<Vec<_>>();
        let (area, right) = (seen.iter().map(|&p| factors.area[p as usize]).collect::<Vec<_>>(), at(&whole_light));
        let drift = relative_error(&printed.light, &exact.light, &area);
        if frame == 0 {
            row.first_drift = drift;
        } else {
            let product = 3 * (seen.len() * lit.len()) as u64;
            row.entered += changed.entered;
            row.printed.add(changed.printed.0 + product, changed.printed.1 + printed.seconds);
            row.exact.add(changed.exact.0 + product, changed.exact.1 + exact.seconds);
        }
        row.last_drift = drift;
        row.printed_error = row.printed_error.max(relative_error(&printed.light, &right, &area));
        row.exact_error = row.exact_error.max(relative_error(&exact.light, &right, &area));
        let share = |some: &[u32]| some.len() as f64 / flight.there.len().max(1) as f64;
        shares.push((share(&seen), share(&lit)));
        row.visible += share(&seen) / f64::from(FRAMES);
        row.lit += share(&lit) / f64::from(FRAMES);
        if is_cancelled() {
            return Err(shell::Error::Cancelled.into());
        }
    }
    Ok((row, shares))
}

/// Both matrices, and the patches in them.
pub(super) struct Flight<'a> {
    subject: &'a Subject,
    /// Form factors of each patch.
    rows: Vec<Vec<(u32, f32)>>,
    pub slots: usize,
    printed: PrintedMatrix,
    exact: LocalMatrix,
    pub there: BTreeSet<u32>,
}

/// Work of a change: multiplications and seconds of each matrix.
pub(super) struct Change {
    entered: usize,
    pub printed: (u64, f64),
    pub exact: (u64, f64),
}

/// Irradiance of the visible patches, and how long it took.
pub(super) struct Product {
    pub light: Vec<Vec4>,
    pub seconds: f64,
}

impl<'a> Flight<'a> {
    /// Without patches so far, with room for so many.
    pub fn new(subject: &'a Subject, slots: usize) -> Result<Self, Error> {
        let slots = slots.min(subject.bake.mesh().patches.len());
        Ok(Self {
            subject,
            rows: subject.rows(),
            slots,
            printed: PrintedMatrix::new(slots)?,
            exact: LocalMatrix::new(slots)?,
            there: BTreeSet::new(),
        })
    }

    /// Patches near a place take the slots of those far from it, `budget` of them at most.
    pub fn change(&mut self, eye: Vec3, budget: usize) -> Result<Change, Error> {
        let patches = &self.subject.bake.mesh().patches;
        let distance: Vec<f32> = patches.iter().map(|patch| patch.centroid.distance(eye)).collect();
        let choice = choose(&distance, |patch| self.there.contains(&patch), self.slots, HYSTERESIS, budget);
        let entering = self.subject.entering(&choice.enter, &self.rows);
        let before = [self.printed.work(), self.exact.work()];
        let ((), printed_s) = timed(|| {
            choice.leave.iter().try_for_each(|&patch| self.printed.remove(patch))?;
            Ok(entering.iter().try_for_each(|one| self.printed.add(one))?)
        })?;
        let ((), exact_s) = timed(|| {
            self.exact.remove(&choice.leave)?;
            Ok(self.exact.add(&entering)?)
        })?;
        choice.leave.iter().for_each(|patch| _ = self.there.remove(patch));
        self.there.extend(&choice.enter);
        Ok(Change {
            entered: choice.enter.len(),
            printed: (self.printed.work() - before[0], printed_s),
            exact: (self.exact.work() - before[1], exact_s),
        })
    }

    /// Which of some patches are in the matrices.
    fn those_of(&self, patches: &HashSet<u32>) -> Vec<u32> {
        self.there.iter().copied().filter(|patch| patches.contains(patch)).collect()
    }

    /// Patches in the matrices that send some of this light.
    pub fn lit(&self, light: &[Vec4]) -> Vec<u32> {
        self.there.iter().copied().filter(|patch| light[*patch as usize].truncate() != Vec3::ZERO).collect()
    }

    /// By the printed matrix, and by ours.
    pub fn products(&self, places: &Places) -> Result<(Product, Product), Error> {
        let Self { slots, printed, exact, .. } = self;
        let (light, seconds) =
            timed(|| places.product(*slots, &|p| printed.slot(p), &|v, l, e, h| printed.product(v, l, e, h)))?;
        let ours = Product { light, seconds };
        let (light, seconds) =
            timed(|| places.product(*slots, &|p| exact.slot(p), &|v, l, e, h| exact.product(v, l, e, h)))?;
        Ok((ours, Product { light, seconds }))
    }
}

/// Patches that a camera sees.
fn visible(study: &Study, subject: &Subject, camera: &Camera) -> HashSet<u32> {
    let scene = &study.loaded.scene;
    let patch = |pixel: u32| {
        let hit = primary_hit(&scene.tables(), camera, pixel, 0);
        subject.bake.mesh().patch(scene, &hit, primary_direction(camera, pixel, 0))
    };
    (0..camera.width * camera.height).map(patch).filter(|&patch| patch != NONE).collect()
}

/// Rows and columns of a product.
pub(super) struct Places<'a> {
    pub seen: &'a [u32],
    pub lit: &'a [u32],
    /// Exitance of all patches.
    pub light: &'a [Vec4],
}

type Multiply<'a> = dyn Fn(&[u32], &[u32], &[Vec4], &mut [Vec4]) -> Result<(), localmatrix::Error> + 'a;

impl Places<'_> {
    /// Irradiance of the visible patches by a matrix.
    pub fn product(
        &self,
        slots: usize,
        slot: &dyn Fn(u32) -> Option<u32>,
        product: &Multiply,
    ) -> Result<Vec<Vec4>, Error> {
        let of = |patches: &[u32]| patches.iter().filter_map(|&patch| slot(patch)).collect::<Vec<u32>>();
        let rows = of(self.seen);
        let columns = of(self.lit);
        let mut exitance = vec![Vec4::ZERO; slots];
        let mut irradiance = vec![Vec4::ZERO; slots];
        columns.iter().zip(self.lit).for_each(|(&slot, &patch)| exitance[slot as usize] = self.light[patch as usize]);
        product(&rows, &columns, &exitance, &mut irradiance)?;
        Ok(rows.iter().map(|&slot| irradiance[slot as usize]).collect())
    }
}

fn table(rows: &[Row]) -> Table {
    let percent = |share: f64| format!("{} %", significant(100.0 * share));
    let cells = |row: &Row| {
        let mut cells = vec![row.patches.to_string(), row.slots.to_string(), row.entered.to_string()];
        cells.extend([row.visible, row.lit].map(percent));
        for work in [row.whole, row.printed, row.exact] {
            cells.push(format!("{} / {}", significant(work.multiplications * 1e-6), significant(work.ms)));
        }
        cells.extend([row.printed_error, row.exact_error, row.first_drift, row.last_drift].map(percent));
        cells
    };
    let heads = [
        "patches",
        "in the matrix",
        "entered",
        "visible",
        "lit",
        "whole: millions / ms",
        "printed",
        "ours",
        "error of the printed",
        "of ours",
        "printed beside ours, first frame",
        "last",
    ];
    Table {
        caption: format!(
            "A frame of {FRAMES} along the scene: multiplications (all channels) and processor time of the product \
             with the whole matrix, and of changes and the product P_Vis × P_Lit of the local one. Errors of the \
             light of visible patches beside that of all patches, the greatest; the nearest patches alone lose the \
             light of the others."
        ),
        head: heads.map(str::to_owned).to_vec(),
        rows: rows.iter().map(cells).collect(),
    }
}
