//! Errors of bakes.

use alloc::string::String;
use alloc::vec::Vec;

/// Why a bake was refused, or a block of it.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum BakeError {
    /// The system refuses.
    #[error("{path}: {reason}; check that it exists, may be read or written, and that the disk has room")]
    File {
        /// The file.
        path: String,
        /// Message of the operating system.
        reason: String,
    },
    /// Another kind of file.
    #[error("{path} is no bake: {reason}; bake the scene first")]
    NotABake {
        /// The file.
        path: String,
        /// Why not.
        reason: String,
    },
    /// Another version.
    #[error("{path} is a bake of version {found}, and this program reads version {expected}; bake the scene again")]
    Version {
        /// The file.
        path: String,
        /// Its version.
        found: u32,
        /// Ours.
        expected: u32,
    },
    /// Header or world were changed or cut: nothing can be read without them.
    #[error(
        "{path}: {part} at byte {offset} was altered or cut ({reason}); copy the file again, or bake the scene again"
    )]
    Damaged {
        /// The file.
        path: String,
        /// The part concerned.
        part: &'static str,
        /// Offset of its beginning.
        offset: u64,
        /// Description of the fault.
        reason: String,
    },
    /// A block was changed or cut; the others are good.
    #[error(
        "{path}: block {block} at byte {offset} was altered or cut ({reason}); copy the file again, or bake the scene \
         again"
    )]
    Block {
        /// The file.
        path: String,
        /// Its number.
        block: u32,
        /// Offset of its beginning.
        offset: u64,
        /// Description of the fault.
        reason: String,
    },
    /// Something else was begun under this name.
    #[error("{path} holds the beginning of another bake ({reason}); remove it, or choose another name")]
    OtherBeginning {
        /// The file.
        path: String,
        /// The difference.
        reason: String,
    },
    /// A part where a whole bake is needed, or the other way round.
    #[error("{path} is {found}, and {expected} is needed; join the parts of a bake first")]
    Kind {
        /// The file.
        path: String,
        /// Value found.
        found: String,
        /// Expected value.
        expected: &'static str,
    },
    /// A part that does not belong to the first one.
    #[error("{path} is of {what} than {first}; give the parts of one bake")]
    OtherPart {
        /// The part.
        path: String,
        /// The difference: another scene, other settings.
        what: &'static str,
        /// The first part.
        first: String,
    },
    /// A part twice.
    #[error("{path} and {first} are both part {part}; give each part once")]
    DoubledPart {
        /// The part.
        path: String,
        /// First of the equal ones.
        first: String,
        /// Its number.
        part: u32,
    },
    /// Parts that were not given.
    #[error("of {parts} parts these are missing: {}; bake them, too", list(.missing))]
    MissingParts {
        /// All parts.
        parts: u32,
        /// Those that are missing.
        missing: Vec<u32>,
    },
    /// More than can be counted, or tables that do not fit together.
    #[error("{name} is {found}; it must be {rule}")]
    Setting {
        /// Name of the value.
        name: &'static str,
        /// The value.
        found: u64,
        /// Rule that it breaks.
        rule: &'static str,
    },
}

fn list(numbers: &[u32]) -> String {
    numbers.iter().map(|n| alloc::format!("{n}")).collect::<Vec<_>>().join(", ")
}
