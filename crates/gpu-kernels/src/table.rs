//! The host's table of kernels: name, module, bindings, invocations a workgroup, and host form. The rows follow from
//! the declarations in the files of the methods.

mod row;

pub use row::{Access, Binding, BindingKind, ImageFormat, Invocation, Kernel, MAX_GROUPS_X};

pub use crate::firstshot::*;
pub use crate::formfactor::*;
pub use crate::localmatrix::*;
pub use crate::low_rank::*;
pub use crate::multibounce::*;
pub use crate::patches::*;
pub use crate::scene::*;
pub use crate::temporal::*;
pub use crate::transport::*;

/// The kernels of each method.
static METHODS: [&[&Kernel]; 9] = [
    crate::scene::KERNELS,
    crate::transport::KERNELS,
    crate::formfactor::KERNELS,
    crate::patches::KERNELS,
    crate::multibounce::KERNELS,
    crate::low_rank::KERNELS,
    crate::temporal::KERNELS,
    crate::localmatrix::KERNELS,
    crate::firstshot::KERNELS,
];

const fn count() -> usize {
    let mut count = 0;
    let mut method = 0;
    while method < METHODS.len() {
        count += METHODS[method].len();
        method += 1;
    }
    count
}

const fn all() -> [&'static Kernel; count()] {
    let mut all = [METHODS[0][0]; count()];
    let mut filled = 0;
    let mut method = 0;
    while method < METHODS.len() {
        let mut k = 0;
        while k < METHODS[method].len() {
            all[filled] = METHODS[method][k];
            filled += 1;
            k += 1;
        }
        method += 1;
    }
    all
}

/// Every kernel, in the order of the methods.
pub static KERNELS: &[&Kernel] = &all();

/// Module bytes on a word boundary.
#[repr(C, align(4))]
#[doc(hidden)]
pub struct Aligned<T: ?Sized>(pub T);

#[doc(hidden)]
pub const fn buffer<T>(name: &'static str, access: Access) -> Binding {
    Binding { name, access, kind: BindingKind::Storage { stride: size_of::<T>() as u32 } }
}

#[doc(hidden)]
pub const fn image(name: &'static str, formats: &'static [ImageFormat]) -> Binding {
    Binding { name, access: Access::Read, kind: BindingKind::SampledImage { formats } }
}

/// The name of a kernel, which must be that of its row in small letters; else the crate does not
/// compile.
#[doc(hidden)]
pub const fn checked_name(row: &str, name: &'static str) -> &'static str {
    let row = row.as_bytes();
    let small = name.as_bytes();
    assert!(row.len() == small.len(), "a kernel is named after its row, in small letters");
    let mut k = 0;
    while k < row.len() {
        let same = row[k].to_ascii_lowercase() == small[k];
        assert!(same, "a kernel is named after its row, in small letters");
        k += 1;
    }
    name
}
