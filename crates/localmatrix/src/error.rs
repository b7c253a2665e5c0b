//! Errors of patches and their matrix.

/// Why a change was refused. The patches that are there stay as they were; ghosts may have given up their slots.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum Error {
    /// A table or a setting that cannot be.
    #[error(transparent)]
    Shared(#[from] transport::Error),
    /// A patch has a value that is no number, or out of range.
    #[error("{name} of patch {patch} is {value}; it must be {rule}")]
    Value {
        /// Name of the value.
        name: &'static str,
        /// The patch.
        patch: u32,
        /// Its value.
        value: f32,
        /// Rule that it breaks.
        rule: &'static str,
    },
    /// A patch enters that is there, or twice.
    #[error("patch {patch} is there already")]
    AlreadyThere {
        /// The patch.
        patch: u32,
    },
    /// A patch that is not there.
    #[error("patch {patch} is not there")]
    NotThere {
        /// The patch.
        patch: u32,
    },
    /// A slot that there is not.
    #[error("there is no slot {slot}; there are {slots}")]
    NoSlot {
        /// The slot.
        slot: u32,
        /// Slots that there are.
        slots: usize,
    },
    /// No slots are left: let patches leave first.
    #[error("{needed} patches enter, but of {slots} slots only {free} are free or hold ghosts: let others leave first")]
    Full {
        /// Patches that enter.
        needed: usize,
        /// Slots that can be had.
        free: usize,
        /// All slots.
        slots: usize,
    },
    /// With this patch light would grow without end.
    #[error("light grows without end with patch {patch}: its form factors times the reflectance exceed 1")]
    Singular {
        /// The patch.
        patch: u32,
    },
    /// A bake, or a block of it.
    #[error(transparent)]
    Bake(#[from] crate::host::BakeError),
    /// A world whose nodes are no forest, or with a value that is none.
    #[error("node {node} cannot be: {reason}")]
    Node {
        /// The node.
        node: u32,
        /// Description of the fault.
        reason: &'static str,
    },
    /// Stopped by the caller.
    #[error("stopped")]
    Cancelled,
}
