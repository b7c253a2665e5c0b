//! Errors of pictures, reference folders, comparisons and saved accumulations.

use std::io;
use std::path::PathBuf;

/// Why a picture, a comparison or an accumulation failed. Messages name the file and say what to do.
#[derive(Debug, thiserror::Error)]
pub enum Error {
    /// A file cannot be opened or read.
    #[error("cannot read {}: {source}; check that the file exists and may be read", path.display())]
    Read {
        /// The file.
        path: PathBuf,
        /// Error from the operating system.
        source: io::Error,
    },
    /// A file cannot be written.
    #[error("cannot write {}: {source}; check that its folder exists, may be written to and has room", path.display())]
    Write {
        /// The file.
        path: PathBuf,
        /// Error from the operating system.
        source: io::Error,
    },
    /// A file is not the picture it should be.
    #[error("cannot read {} as a picture: {reason}; EXR, HDR and PNG files are understood", path.display())]
    Decode {
        /// The file.
        path: PathBuf,
        /// Message of the decoder.
        reason: String,
    },
    /// A picture could not be encoded.
    #[error("cannot write {} as a picture: {reason}", path.display())]
    Encode {
        /// The file.
        path: PathBuf,
        /// Message of the encoder.
        reason: String,
    },
    /// The picture is smaller than the window of a metric.
    #[error("pictures of {width} x {height} cannot be compared: at least {least} x {least} pixels are needed")]
    TooSmall {
        /// Width.
        width: u32,
        /// Height.
        height: u32,
        /// Least edge.
        least: u32,
    },
    /// A pixel is NaN or infinite.
    #[error("pixel {pixel} of the {which} picture is not a finite number")]
    NotFinite {
        /// "first" or "reference".
        which: &'static str,
        /// Its index, row by row from the top.
        pixel: usize,
    },
    /// Nothing is left to compare.
    #[error("nothing to compare: {reason}")]
    Nothing {
        /// Why.
        reason: &'static str,
    },
    /// The mask has another number of pixels.
    #[error("the mask has {found} pixels, the pictures have {expected}")]
    MaskLength {
        /// Pixels of the pictures.
        expected: usize,
        /// Pixels of the mask.
        found: usize,
    },
    /// A table of points is damaged.
    #[error("{} line {line}: {reason}", path.display())]
    Points {
        /// The file.
        path: PathBuf,
        /// Line, counted from 1.
        line: usize,
        /// Description of the fault.
        reason: String,
    },
    /// There are not as many of one thing as of another.
    #[error("{found} values given for {expected} {of}")]
    Count {
        /// Things that each need a value.
        of: &'static str,
        /// Number of such things.
        expected: usize,
        /// Values.
        found: usize,
    },
    /// The accumulation belongs to a picture of another size.
    #[error(
        "the accumulation is for {} x {} pixels, the camera has {} x {}",
        accumulation.0, accumulation.1, camera.0, camera.1
    )]
    AccumulationSize {
        /// Size of the accumulation.
        accumulation: (u32, u32),
        /// Size of the camera's picture.
        camera: (u32, u32),
    },
    /// A setting has a value that makes no sense.
    #[error("{name} {value}: must be {rule}")]
    Setting {
        /// Name of the setting.
        name: &'static str,
        /// Its value.
        value: f64,
        /// Rule that it breaks.
        rule: &'static str,
    },
    /// A normal is no direction.
    #[error("the point {position} with the normal {normal} has no side")]
    NoDirection {
        /// Position, m.
        position: glam::Vec3,
        /// Value given for the normal.
        normal: glam::Vec3,
    },
    /// A scene could not be made.
    #[error(transparent)]
    Scene(#[from] scene::Error),
    /// A file is no accumulation that can be resumed.
    #[error("cannot resume from {}: {reason}", path.display())]
    Resume {
        /// The file.
        path: PathBuf,
        /// Why not.
        reason: ResumeError,
    },
}

/// Why an accumulation file is refused.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum ResumeError {
    /// The magic number is missing.
    #[error("it is not an accumulation of the path tracer")]
    Magic,
    /// Written by another version.
    #[error("it has format version {found}, this program reads version {supported}; delete it to start afresh")]
    Version {
        /// Version of the file.
        found: u32,
        /// Version understood.
        supported: u32,
    },
    /// The length does not fit the header.
    #[error("it has {found} bytes where {expected} are expected (truncated?); delete it to start afresh")]
    Length {
        /// Bytes expected.
        expected: u64,
        /// Bytes found.
        found: u64,
    },
    /// The checksum is wrong.
    #[error("its checksum is wrong (altered or damaged); delete it to start afresh")]
    Checksum,
    /// Made from another scene or camera.
    #[error("it was made from another scene or camera; delete it to start afresh")]
    Scene,
    /// Made with other settings.
    #[error("it was made with other settings (seed, bounces or strategy); use the same or delete it to start afresh")]
    Settings,
}
