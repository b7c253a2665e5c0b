//! The plain data that CPU and GPU share, field for field.
