//! Photons against other ways to find the same light.
#[test]
fn nothing_yet() {}
