//! Arrays of numbers on both sides of the border.

use numpy::{PyArray1, PyArray2, PyArrayMethods as _, PyReadonlyArray1, PyReadonlyArray2, PyUntypedArrayMethods as _};
use patchlight::glam::{Vec3, Vec4};
use patchlight::transport::Csr;
use pyo3::prelude::*;

use crate::error::input;

/// Index pointers, columns and values of compressed sparse rows, and their shape: what scipy makes a matrix of.
pub type CsrParts<'py> =
    (Bound<'py, PyArray1<i64>>, Bound<'py, PyArray1<i32>>, Bound<'py, PyArray1<f32>>, (usize, usize));

/// Rows of three numbers, without a copy.
pub fn vectors<'a>(array: &'a PyReadonlyArray2<f32>, name: &str) -> PyResult<&'a [Vec3]> {
    if array.shape()[1] != 3 {
        return Err(input(format!("{name} has {} columns; give three, x, y and z", array.shape()[1])));
    }
    let numbers = array.as_slice().map_err(|_| input(format!("{name} is not contiguous")))?;
    Ok(bytemuck::cast_slice(numbers))
}

/// Rows of three vertex numbers, without a copy.
pub fn triples<'a>(array: &'a PyReadonlyArray2<u32>, name: &str) -> PyResult<&'a [[u32; 3]]> {
    if array.shape()[1] != 3 {
        return Err(input(format!("{name} has {} columns; give three, the corners of triangles", array.shape()[1])));
    }
    let numbers = array.as_slice().map_err(|_| input(format!("{name} is not contiguous")))?;
    Ok(bytemuck::cast_slice(numbers))
}

/// Numbers, without a copy.
pub fn numbers<'a, T: numpy::Element>(array: &'a PyReadonlyArray1<T>, name: &str) -> PyResult<&'a [T]> {
    array.as_slice().map_err(|_| input(format!("{name} is not contiguous")))
}

/// An array `(n, 3)`.
pub fn from_vectors<'py>(py: Python<'py>, values: &[Vec3]) -> PyResult<Bound<'py, PyArray2<f32>>> {
    PyArray1::from_slice(py, bytemuck::cast_slice(values)).reshape([values.len(), 3])
}

/// An array `(n, 3)` of the first three components.
pub fn from_rgb<'py>(py: Python<'py>, values: &[Vec4]) -> PyResult<Bound<'py, PyArray2<f32>>> {
    let values: Vec<Vec3> = values.iter().map(|value| value.truncate()).collect();
    from_vectors(py, &values)
}

/// The parts of a sparse matrix.
pub fn from_csr<'py>(py: Python<'py>, csr: Csr) -> CsrParts<'py> {
    let starts: Vec<i64> = csr.row_start.iter().map(|&start| i64::from(start)).collect();
    let columns: Vec<i32> = bytemuck::cast_slice(&csr.column_index).to_vec();
    let shape = (csr.rows, csr.columns);
    (PyArray1::from_vec(py, starts), PyArray1::from_vec(py, columns), PyArray1::from_vec(py, csr.values), shape)
}
