//! Compares the header with the sources; see its test.
