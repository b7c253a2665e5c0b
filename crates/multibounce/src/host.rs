//! The host side: solvers, compression and products on all cores.
