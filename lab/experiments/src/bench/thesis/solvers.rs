//! Section 2.2.5: classic solvers of all bounces, and what they take for their error.

use std::sync::Arc;

use ::patches::PatchKind;
use patchlight::{Bake, BakeSettings, Estimator, Method as _, ReceiverKind};
use serde::Serialize;
use shell::operator_error::relative_error;
use solvers::{Links, Samples, Solved, Solver};

use super::matrix::timed;
use super::{Outcome, Study};
use crate::error::Error;
use crate::measure::own_light;
use crate::output;
use crate::progress::is_cancelled;
use crate::report::{Table, significant};

/// Samples of solvers by chance for each patch.
const SAMPLES: [u32; 2] = [100, 1600];
/// Most power that a link carries, as a share of the emitted power.
const LINKS: [f64; 3] = [1e-3, 1e-4, 1e-5];

/// A solver with its settings.
#[derive(Serialize)]
struct Row {
    solver: String,
    /// Sweeps, shots, iterations, steps or passes.
    steps: u32,
    /// Links, and pairs of parts without them.
    links: Option<(usize, usize)>,
    bytes: u64,
    /// Time of all processors.
    ms: f64,
    /// Error of the irradiance beside elimination, L2 by area.
    error: f64,
}

/// All solvers on the polygons of a scene, under its own light.
pub(super) fn solvers(study: &Study) -> Result<Outcome, Error> {
    let Study { args, common, loaded, progress, .. } = *study;
    let settings = BakeSettings::default()
        .with_patches(PatchKind::Polygon)
        .with_patch_count(study.counts[0] as usize)
        .with_estimator(Estimator::Hemisphere { rays: args.rays })
        .with_receivers(ReceiverKind::Pixels)
        .with_seed(common.seed);
    let bake = Arc::new(Bake::build(&loaded.scene, &settings, progress)?);
    let source = own_light(&loaded.scene, bake.mesh(), settings.sample_rays, settings.seed);
    let patches = bake.mesh().patches.len();
    let areas = bake.mesh().areas();
    let exact = Solved::new(Solver::Lu, &bake)?.solution(&source)?.0.irradiance;
    let mut solvers = vec![
        ("elimination (2.4)".to_owned(), Solver::Lu),
        ("gathering in place".to_owned(), Solver::GaussSeidel),
        ("shooting".to_owned(), Solver::Shooting),
    ];
    for samples in SAMPLES {
        let all = Samples { count: samples * patches as u32, seed: common.seed };
        solvers.push((format!("sending samples, {samples} a patch"), Solver::StochasticJacobi(all)));
        solvers.push((format!("walks of light, {samples} a patch"), Solver::RandomWalks(all)));
    }
    for error in LINKS {
        solvers
            .push((format!("hierarchical, ε = {error:e}"), Solver::Hierarchical(Links { error, seed: common.seed })));
    }
    let mut rows = Vec::new();
    for (name, solver) in solvers {
        progress.note(&name);
        let solved = Solved::new(solver, &bake)?;
        let ((solution, links), seconds) = timed(|| Ok(solved.solution(&source)?))?;
        let is_linked = links.leaves > 0;
        rows.push(Row {
            solver: name,
            steps: solution.iterations,
            links: is_linked.then(|| (links.links, links.leaves * links.leaves.saturating_sub(1) / 2)),
            bytes: if is_linked { links.bytes() } else { solved.report().bytes.values().sum() },
            ms: 1e3 * seconds,
            error: relative_error(&solution.irradiance, &exact, &areas),
        });
        if is_cancelled() {
            return Err(shell::Error::Cancelled.into());
        }
    }
    Ok(Outcome {
        rows: serde_json::to_value(&rows).unwrap_or_default(),
        tables: vec![table(&rows, patches)],
        plots: Vec::new(),
    })
}

fn table(rows: &[Row], patches: usize) -> Table {
    let cells = |row: &Row| {
        vec![
            row.solver.clone(),
            row.steps.to_string(),
            row.links.map_or_else(|| "–".to_owned(), |(links, pairs)| format!("{links} of {pairs}")),
            output::bytes(row.bytes),
            significant(row.ms),
            format!("{} %", significant(100.0 * row.error)),
        ]
    };
    let heads = ["solver", "steps", "links of pairs", "form factors or links", "processor ms", "error"];
    Table {
        caption: format!(
            "All bounces between {patches} polygons under the scene's own light. Error of the irradiance beside \
             elimination; form factors of links are exact but for shadow rays, all others are by rays of hemispheres."
        ),
        head: heads.map(str::to_owned).to_vec(),
        rows: rows.iter().map(cells).collect(),
    }
}
