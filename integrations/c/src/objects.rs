//! Objects that move.

use patchlight::ObjectId;
use patchlight::glam::Affine3A;

use crate::border::{Outcome, PlStatus, guard, handle, input, room, structure, table};
use crate::field::PlField;
use crate::scene::{PlMesh, transform_of};

impl PlField {
    fn object(&self, object: u32) -> Outcome<ObjectId> {
        let found = self.objects.get(object as usize).copied().flatten();
        found.ok_or_else(|| input(format!("object {object} is not of this field")))
    }
}

/// The transform of three rows of four numbers; none for NULL.
///
/// # Safety
/// `rows` is NULL or begins twelve numbers.
unsafe fn place(rows: *const f32) -> Outcome<Affine3A> {
    if rows.is_null() {
        return Ok(Affine3A::IDENTITY);
    }
    // SAFETY: as the caller promises.
    Ok(transform_of(unsafe { table(rows, 12, "transform") }?))
}

/// Adds an object that moves through the scene: it throws shadows, takes light away from what is behind it, and reflects. A
/// closed mesh of a few hundred triangles, with a material of the baked scene; its own transform comes before `transform`,
/// three rows of four numbers, or NULL. Its number goes to `out_object`.
///
/// # Safety
/// Pointers are what they say.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn pl_field_add_object(
    field: *mut PlField,
    mesh: *const PlMesh,
    transform: *const f32,
    out_object: *mut u32,
) -> PlStatus {
    guard(|| {
        // SAFETY: as the caller promises.
        let field = unsafe { handle(field, "field") }?;
        // SAFETY: as the caller promises.
        let own = unsafe { structure(mesh, PlMesh::default()) }?;
        // SAFETY: as the caller promises.
        let (mesh, transform) = (unsafe { own.mesh() }?, unsafe { place(transform) }?);
        // SAFETY: as the caller promises.
        let out = unsafe { room(out_object, 1, "out_object") }?;
        let id = field.renderer.light_mut().objects().insert(&mesh, transform)?;
        field.objects.push(Some(id));
        out[0] = field.objects.len() as u32 - 1;
        Ok(())
    })
}

/// Moves an object, from the next update on: three rows of four numbers.
///
/// # Safety
/// `transform` is NULL, for its first place, or begins twelve numbers.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn pl_field_move_object(field: *mut PlField, object: u32, transform: *const f32) -> PlStatus {
    guard(|| {
        // SAFETY: as the caller promises.
        let field = unsafe { handle(field, "field") }?;
        let id = field.object(object)?;
        // SAFETY: as the caller promises.
        let transform = unsafe { place(transform) }?;
        field.renderer.light_mut().objects().set_transform(id, transform)?;
        Ok(())
    })
}

/// Removes an object; others keep their numbers.
///
/// # Safety
/// The handle is live.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn pl_field_remove_object(field: *mut PlField, object: u32) -> PlStatus {
    guard(|| {
        // SAFETY: as the caller promises.
        let field = unsafe { handle(field, "field") }?;
        let id = field.object(object)?;
        field.renderer.light_mut().objects().remove(id)?;
        field.objects[object as usize] = None;
        Ok(())
    })
}
