//! Plain data as the bytes that lie in memory, for serde: `#[serde(with = "scene::pod::table")]` writes a table and
//! `#[serde(with = "scene::pod::value")]` a single value without looking at its elements, so that formats of bytes copy
//! tables as fast as memory does. The order of bytes is the machine's: who writes files says which it was.

use core::fmt::{self, Formatter};
use core::marker::PhantomData;

use alloc::vec::Vec;
use bytemuck::Pod;
use serde::de::{Deserializer, Error, Visitor};
use serde::ser::Serializer;

/// Takes bytes as a table of `T`.
struct Table<T>(PhantomData<T>);

impl<T: Pod> Visitor<'_> for Table<T> {
    type Value = Vec<T>;

    fn expecting(&self, f: &mut Formatter) -> fmt::Result {
        write!(f, "a table of values of {} bytes", size_of::<T>())
    }

    fn visit_bytes<E: Error>(self, bytes: &[u8]) -> Result<Vec<T>, E> {
        if !bytes.len().is_multiple_of(size_of::<T>().max(1)) {
            return Err(E::invalid_length(bytes.len(), &self));
        }
        Ok(bytemuck::pod_collect_to_vec(bytes))
    }

    fn visit_byte_buf<E: Error>(self, bytes: Vec<u8>) -> Result<Vec<T>, E> {
        self.visit_bytes(&bytes)
    }
}

/// Tables: `Vec<T>`, `Arc<[T]>`, `Arc<Vec<T>>`.
pub mod table {
    use core::ops::Deref;

    use super::*;

    /// Writes the bytes of a table.
    ///
    /// # Errors
    /// The serializer's.
    pub fn serialize<T, C, S>(table: &C, serializer: S) -> Result<S::Ok, S::Error>
    where
        T: Pod,
        C: Deref<Target: AsRef<[T]>>,
        S: Serializer,
    {
        serializer.serialize_bytes(bytemuck::cast_slice((**table).as_ref()))
    }

    /// Reads them.
    ///
    /// # Errors
    /// The deserializer's; bytes that are no whole number of values.
    pub fn deserialize<'de, T: Pod, C: From<Vec<T>>, D: Deserializer<'de>>(deserializer: D) -> Result<C, D::Error> {
        Ok(deserializer.deserialize_bytes(Table(PhantomData))?.into())
    }
}

/// Single values.
pub mod value {
    use super::*;

    /// Writes the bytes of a value.
    ///
    /// # Errors
    /// The serializer's.
    pub fn serialize<T: Pod, S: Serializer>(value: &T, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.serialize_bytes(bytemuck::bytes_of(value))
    }

    /// Reads them.
    ///
    /// # Errors
    /// The deserializer's; bytes that are not those of one value.
    pub fn deserialize<'de, T: Pod, D: Deserializer<'de>>(deserializer: D) -> Result<T, D::Error> {
        let values: Vec<T> = deserializer.deserialize_bytes(Table(PhantomData))?;
        match values[..] {
            [value] => Ok(value),
            _ => Err(D::Error::invalid_length(values.len(), &"one value")),
        }
    }
}
