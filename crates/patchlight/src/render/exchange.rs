//! What patches and facets exchange: form factors by the estimator of the settings.

use formfactor::{
    AreaToArea, Contour, Csr, Hemisphere, HitRows, Operator, PointToPoint, add_hit_rows, balance, form_factors,
    sparse_rows,
};
use scene::Scene;

use super::classic::{ClassicSettings, Estimator, csr_bytes};
use super::proceed;
use super::senders::{Columns, Senders};
use crate::error::Error;

/// Fewest rays of a facet's row.
const LEAST_FACET_RAYS: u64 = 64;

/// Form factors between patches, and between facets.
#[derive(Clone)]
pub struct Exchange {
    /// From patch to patch: means of the facets' rows.
    pub factors: Csr,
    /// From facet to facet; none where the facets are the patches.
    pub facet_rows: Option<HitRows>,
    /// Share of each facet's hemisphere that sees no geometry.
    pub sky_factor: Vec<f32>,
}

impl Exchange {
    /// What facets gather by.
    pub fn facet_operator(&self) -> &dyn Operator {
        self.facet_rows.as_ref().map_or(&self.factors, |rows| rows)
    }

    /// Bytes of what facets gather by beside what patches do: where `is_there`, theirs are in a frame anyway.
    pub fn facet_bytes(&self, is_there: bool) -> u64 {
        match &self.facet_rows {
            Some(rows) => rows.bytes() as u64,
            None if is_there => 0,
            None => csr_bytes(&self.factors),
        }
    }
}

pub fn exchange(
    scene: &Scene,
    senders: &Senders,
    settings: &ClassicSettings,
    report: &(dyn Fn(f32) -> bool + Sync),
) -> Result<Exchange, Error> {
    let surfaces = senders.exchange(scene, settings.seed);
    let progress = |done: usize, total: usize| proceed(report, done, total);
    if !senders.polygons.is_empty() {
        let estimator: Box<dyn formfactor::Estimator> = match settings.estimator {
            Estimator::Hemisphere { rays } => Box::new(Hemisphere { rays }),
            Estimator::Contour => Box::new(Contour::default()),
            Estimator::Area => Box::new(AreaToArea::default()),
            Estimator::Point => Box::new(PointToPoint::default()),
        };
        let mut rows = form_factors(&*estimator, &surfaces, &progress)?;
        balance(&mut rows.factors, &mut rows.sky_factor, &senders.areas(), None)?;
        let factors = rows.factors.to_csr(0.0)?;
        return Ok(Exchange { factors, facet_rows: None, sky_factor: rows.sky_factor });
    }
    let without_outlines = |estimator| Err(formfactor::Error::NoOutlines { estimator }.into());
    let rays = match settings.estimator {
        Estimator::Hemisphere { rays } => rays,
        Estimator::Contour => return without_outlines("Contour"),
        Estimator::Area => return without_outlines("AreaToArea"),
        Estimator::Point => return without_outlines("PointToPoint"),
    };
    let (patches, facets) = (senders.patches.len(), senders.facets.len());
    let rays = facet_rays(rays, senders);
    // No balance: the areas of clusters are estimates by samples, and reciprocity with them would make good rows worse.
    if facets == patches {
        let rows = sparse_rows(&surfaces, rays, &progress)?;
        return Ok(Exchange { factors: rows.factors, facet_rows: None, sky_factor: rows.sky_factor });
    }
    let fine = senders.lighting(scene, Columns::Facets, &senders.points, &senders.offsets, settings.seed);
    let mut rows = HitRows::new(facets)?;
    let sky_factor = add_hit_rows(&mut rows, &fine, rays, &progress)?;
    let patch: Vec<u32> = (0..facets as u32).map(|facet| senders.patch_of(facet)).collect();
    let factors = rows.means(&senders.patch_facets, &senders.facet_shares(), &patch, patches)?;
    Ok(Exchange { factors, facet_rows: Some(rows), sky_factor })
}

/// Rays of a facet's row: as many in all as rows of the patches' own would take.
fn facet_rays(rays: u32, senders: &Senders) -> u32 {
    let (patches, facets) = (senders.patches.len(), senders.facets.len());
    (u64::from(rays) * patches as u64).div_ceil(facets.max(1) as u64).max(LEAST_FACET_RAYS) as u32
}
