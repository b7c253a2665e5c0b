//! Shared by the integration tests: seeded inputs, tolerances, the skip rules.
