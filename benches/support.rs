//! Fixed seeds and sizes shared by all benches.
