//! Functions that set one field of a settings type each.

/// Adds `with_FIELD` functions to a settings type.
macro_rules! setters {
    ($settings:ident { $($(#[$doc:meta])* $set:ident($field:ident: $of:ty);)* }) => {
        impl $settings {
            $(
                $(#[$doc])*
                #[must_use]
                pub fn $set(mut self, $field: $of) -> Self {
                    self.$field = $field;
                    self
                }
            )*
        }
    };
}

pub(crate) use setters;
