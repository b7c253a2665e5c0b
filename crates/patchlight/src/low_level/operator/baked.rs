//! Operators by what they are of: those that methods ask for, and that bakes keep.

use rayon::ThreadPoolBuilder;
use runtime::executor::Executor;
use serde::{Deserialize, Serialize};

use super::build::{all_bounces_operator, form_factor_operator};
use super::{Codec, PatchOperator};
use crate::bake::{BakeSettings, ReceiverKind};
use crate::error::Error;
use crate::low_level::frame::LAST_BOUNCES;
use crate::method::temporal::RowKind;
use crate::method::{MethodSettings, Preparation, TemporalSettings};

/// Identity of an operator: its form factors, and its storage.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub enum OperatorKey {
    /// So many bounces, or all.
    Bounces {
        /// Storage of the operator.
        codec: Codec,
        /// Bounces between patches; `None` for all.
        bounces: Option<u32>,
    },
    /// One bounce: the form factors, in low rank.
    FormFactors {
        /// Relative Frobenius error.
        epsilon: f64,
    },
}

/// An operator that a bake keeps.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct BakedOperator {
    /// Identity of the operator.
    pub key: OperatorKey,
    /// The operator.
    pub operator: PatchOperator,
}

impl OperatorKey {
    /// The operator that a method asks for under these settings; none where the method has none, or where there are so
    /// few bounces that patches need none.
    pub fn of(method: &MethodSettings, settings: &BakeSettings) -> Option<Self> {
        let last = if settings.receivers == ReceiverKind::Patches { 0 } else { LAST_BOUNCES };
        let is_needed = settings.bounces.is_none_or(|bounces| bounces > last);
        match *method {
            MethodSettings::Multibounce(codec) if is_needed => {
                Some(Self::Bounces { codec, bounces: settings.bounces.map(|bounces| bounces - last) })
            }
            MethodSettings::Temporal(TemporalSettings { rows: RowKind::AllBounces, .. }) if is_needed => {
                Some(Self::Bounces { codec: Codec::Dense, bounces: settings.bounces.map(|bounces| bounces - last) })
            }
            MethodSettings::Feedback(feedback) if is_needed => Some(Self::FormFactors { epsilon: feedback.epsilon }),
            _ => None,
        }
    }

    /// The operators that methods ask for, each once.
    pub fn of_all<'a>(methods: impl IntoIterator<Item = &'a MethodSettings>, settings: &BakeSettings) -> Vec<Self> {
        let mut all = Vec::new();
        for key in methods.into_iter().filter_map(|method| Self::of(method, settings)) {
            if !all.contains(&key) {
                all.push(key);
            }
        }
        all
    }

    /// The operator that the bake has, else a new one; `device` may build it.
    ///
    /// # Errors
    /// An operator that does not fit into memory, cancellation.
    pub fn find_or_build(
        self,
        with: &Preparation,
        device: &mut (dyn Executor + 'static),
    ) -> Result<PatchOperator, Error> {
        if let Some(baked) = with.bake.operators.iter().find(|baked| baked.key == self) {
            return Ok(baked.operator.clone());
        }
        on_own_threads(|| match self {
            Self::Bounces { codec, bounces } => all_bounces_operator(codec, bounces, with, device),
            Self::FormFactors { epsilon } => form_factor_operator(epsilon, with),
        })
    }
}

/// Works on threads that end with it. Matrix products in AVX-512 leave the upper halves of vector registers in use on
/// the threads that ran them, and all that these do later takes up to half as long again: in a bake of several levels
/// everything after the first operator.
fn on_own_threads<T: Send>(work: impl FnOnce() -> T + Send) -> T {
    match ThreadPoolBuilder::new().num_threads(rayon::current_num_threads()).build() {
        Ok(pool) => pool.install(work),
        // As in a browser.
        Err(_) => work(),
    }
}
