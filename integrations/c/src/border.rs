//! The border: statuses, the message of the last failure, arguments that may be anything.

use std::any::Any;
use std::cell::RefCell;
use std::ffi::{CStr, CString, c_char};
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::ptr;

use patchlight::ErrorKind;
use patchlight::glam::Vec3;

/// Outcome of a function.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[allow(non_camel_case_types)]
pub enum PlStatus {
    /// It did what it says.
    PL_OK = 0,
    /// An argument, a scene or a light that makes no sense.
    PL_INPUT = 1,
    /// A combination of scene, method and device that is not served.
    PL_UNSUPPORTED = 2,
    /// More memory than there is, or than was allowed.
    PL_MEMORY = 3,
    /// A device, its driver or the system.
    PL_DEVICE = 4,
    /// A file that is missing, damaged or of another kind.
    PL_FILE = 5,
    /// The callback, or pl_job_cancel, asked to stop.
    PL_CANCELLED = 6,
    /// A fault of the library; please report it with the message.
    PL_PANIC = 7,
}

/// A failure on its way to the caller.
pub struct Failure(pub PlStatus, pub String);

/// Result of what a function does.
pub type Outcome<T = ()> = Result<T, Failure>;

impl From<patchlight::Error> for Failure {
    fn from(error: patchlight::Error) -> Self {
        let status = match error.kind() {
            ErrorKind::Input => PlStatus::PL_INPUT,
            ErrorKind::Unsupported => PlStatus::PL_UNSUPPORTED,
            ErrorKind::Memory => PlStatus::PL_MEMORY,
            ErrorKind::File => PlStatus::PL_FILE,
            ErrorKind::Cancelled => PlStatus::PL_CANCELLED,
            _ => PlStatus::PL_DEVICE,
        };
        Self(status, error.to_string())
    }
}

/// An argument that makes no sense.
pub fn input(text: impl ToString) -> Failure {
    Failure(PlStatus::PL_INPUT, text.to_string())
}

thread_local! {
    static MESSAGE: RefCell<CString> = RefCell::default();
}

fn keep(message: &str) {
    let text = CString::new(message.replace('\0', " ")).unwrap_or_default();
    MESSAGE.with(|kept| *kept.borrow_mut() = text);
}

/// The message of the last failure on this thread, UTF-8; empty before the first. It names the mesh, the light or the file,
/// and the remedy. Valid until the next failure on the thread.
#[unsafe(no_mangle)]
pub extern "C" fn pl_last_error() -> *const c_char {
    MESSAGE.with(|kept| kept.borrow().as_ptr())
}

/// Version of the library: major · 10000 + minor · 100 + patch.
#[unsafe(no_mangle)]
pub extern "C" fn pl_version() -> u32 {
    let number = |text: &str| text.parse::<u32>().unwrap_or(0);
    let major = number(env!("CARGO_PKG_VERSION_MAJOR"));
    10_000 * major + 100 * number(env!("CARGO_PKG_VERSION_MINOR")) + number(env!("CARGO_PKG_VERSION_PATCH"))
}

/// Runs the body of a function; what goes wrong becomes its status and the thread's message. Nothing unwinds.
pub fn guard(body: impl FnOnce() -> Outcome) -> PlStatus {
    match catch_unwind(AssertUnwindSafe(body)) {
        Ok(Ok(())) => PlStatus::PL_OK,
        Ok(Err(Failure(status, message))) => {
            keep(&message);
            status
        }
        Err(panic) => {
            keep(&text_of(&*panic));
            PlStatus::PL_PANIC
        }
    }
}

fn text_of(panic: &(dyn Any + Send)) -> String {
    let text = panic.downcast_ref::<&str>().map(|text| (*text).to_owned());
    text.or_else(|| panic.downcast_ref::<String>().cloned()).unwrap_or_else(|| "the library panicked".to_owned())
}

/// What a handle points to.
///
/// # Safety
/// It is null, or a live handle of this kind that nobody else uses meanwhile.
pub unsafe fn handle<'a, T>(pointer: *mut T, name: &str) -> Outcome<&'a mut T> {
    // SAFETY: as the caller promises.
    unsafe { pointer.as_mut() }.ok_or_else(|| input(format!("{name} is NULL")))
}

/// What a handle points to, to be read.
///
/// # Safety
/// It is null, or a live handle of this kind that nobody changes meanwhile.
pub unsafe fn shared<'a, T>(pointer: *const T, name: &str) -> Outcome<&'a T> {
    // SAFETY: as the caller promises.
    unsafe { pointer.as_ref() }.ok_or_else(|| input(format!("{name} is NULL")))
}

/// Puts a new handle where the caller wants it.
///
/// # Safety
/// `out` is null or may be written.
pub unsafe fn give<T>(out: *mut *mut T, value: T) -> Outcome {
    if out.is_null() {
        return Err(input("the place for the new handle is NULL"));
    }
    // SAFETY: as the caller promises.
    unsafe { out.write(Box::into_raw(Box::new(value))) };
    Ok(())
}

/// Takes a handle back.
///
/// # Safety
/// It is null, or a live handle of this kind that nobody uses any more.
pub unsafe fn free<T>(pointer: *mut T) {
    if !pointer.is_null() {
        // SAFETY: as the caller promises; it came from `give`.
        let value = unsafe { Box::from_raw(pointer) };
        // What is thrown while it ends goes no further.
        let _ = catch_unwind(AssertUnwindSafe(move || drop(value)));
    }
}

/// A table of the caller's.
///
/// # Safety
/// `first` is null or begins `count` values.
pub unsafe fn table<'a, T>(first: *const T, count: usize, name: &str) -> Outcome<&'a [T]> {
    if count == 0 {
        return Ok(&[]);
    }
    if first.is_null() || !first.is_aligned() {
        return Err(input(format!("{name} has {count} entries and points nowhere")));
    }
    // SAFETY: as the caller promises.
    Ok(unsafe { std::slice::from_raw_parts(first, count) })
}

/// A table of the caller's, to be written.
///
/// # Safety
/// `first` is null or begins `count` values that nobody else uses.
pub unsafe fn room<'a, T>(first: *mut T, count: usize, name: &str) -> Outcome<&'a mut [T]> {
    if count == 0 {
        return Ok(&mut []);
    }
    if first.is_null() || !first.is_aligned() {
        return Err(input(format!("{name} has room for {count} entries and points nowhere")));
    }
    // SAFETY: as the caller promises.
    Ok(unsafe { std::slice::from_raw_parts_mut(first, count) })
}

/// A text of the caller's.
///
/// # Safety
/// It is null or ends with a zero.
pub unsafe fn text<'a>(pointer: *const c_char, name: &str) -> Outcome<&'a str> {
    if pointer.is_null() {
        return Err(input(format!("{name} is NULL")));
    }
    // SAFETY: as the caller promises.
    let text = unsafe { CStr::from_ptr(pointer) };
    text.to_str().map_err(|_| input(format!("{name} is no UTF-8")))
}

/// A structure that begins with its size, of any plain numbers and pointers.
///
/// # Safety
/// All zeros are a value of it, and so is what the caller writes.
pub unsafe trait Sized32: Copy {
    /// Its name.
    const NAME: &'static str;
}

/// A copy of a caller's structure; fields that the caller's older header does not know are those of `default`.
///
/// # Safety
/// `pointer` is null or begins with a size in bytes, and so many bytes may be read.
pub unsafe fn structure<T: Sized32>(pointer: *const T, default: T) -> Outcome<T> {
    if pointer.is_null() {
        return Ok(default);
    }
    // SAFETY: every such structure begins with it.
    let size = unsafe { pointer.cast::<usize>().read_unaligned() };
    if !(size_of::<usize>()..=1 << 16).contains(&size) {
        return Err(input(format!("struct_size of {} is {size}; set it to sizeof({})", T::NAME, T::NAME)));
    }
    let mut own = default;
    let known = size.min(size_of::<T>());
    // SAFETY: `known` bytes may be read by the promise above, and are no more than `own` has; the trait says that any are a
    // value.
    unsafe { ptr::copy_nonoverlapping(pointer.cast::<u8>(), ptr::from_mut(&mut own).cast::<u8>(), known) };
    // SAFETY: so many bytes may be read.
    let beyond = unsafe { std::slice::from_raw_parts(pointer.cast::<u8>().add(known), size - known) };
    if beyond.iter().any(|&byte| byte != 0) {
        let reason = "has fields that this version of the library does not know";
        return Err(input(format!("{} {reason}; link the version of the header", T::NAME)));
    }
    Ok(own)
}

/// A vector that is finite.
pub fn vector(values: [f32; 3], name: &str) -> Outcome<Vec3> {
    let vector = Vec3::from_array(values);
    if vector.is_finite() { Ok(vector) } else { Err(input(format!("{name} is {vector}; it must be finite"))) }
}
