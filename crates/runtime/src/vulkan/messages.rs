//! The validation layer, and what it says.

use std::ffi::{CStr, c_void};
use std::sync::{Arc, Mutex, PoisonError};

use ash::{ext, vk};

use super::error::Error;

/// Name of the layer.
pub const VALIDATION_LAYER: &CStr = c"VK_LAYER_KHRONOS_validation";

/// Messages of the validation layer since the instance was made.
#[derive(Clone, Debug, Default)]
pub struct Messages(Arc<Mutex<Vec<String>>>);

impl Messages {
    /// Takes the messages out.
    pub fn take(&self) -> Vec<String> {
        std::mem::take(&mut *self.0.lock().unwrap_or_else(PoisonError::into_inner))
    }
}

/// Use of the validation layer.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Validation {
    /// No.
    #[default]
    Off,
    /// If it is installed.
    IfThere,
    /// Yes, or an error.
    Required,
}

impl Validation {
    /// Reads a setting of a program, an environment variable say: `0` is off, any other text required; without a text,
    /// debug builds use the layer if it is there.
    pub fn parse(text: Option<&str>) -> Self {
        match text {
            Some("0") => Self::Off,
            Some(text) if !text.is_empty() => Self::Required,
            _ if cfg!(debug_assertions) => Self::IfThere,
            _ => Self::Off,
        }
    }
}

/// Returns true if the layer is installed.
///
/// # Errors
/// What the loader says.
pub fn has_validation_layer(entry: &ash::Entry) -> Result<bool, Error> {
    // SAFETY: no pointer is passed; the function may be called before any instance exists.
    let layers = unsafe { entry.enumerate_instance_layer_properties() }
        .map_err(Error::call("vkEnumerateInstanceLayerProperties"))?;
    Ok(layers.iter().any(|layer| layer.layer_name_as_c_str() == Ok(VALIDATION_LAYER)))
}

/// Returns true if an instance can have debug messages and labels.
pub fn has_debug_utils(entry: &ash::Entry) -> Result<bool, Error> {
    // SAFETY: no layer is named; the function may be called before any instance exists.
    let extensions = unsafe { entry.enumerate_instance_extension_properties(None) }
        .map_err(Error::call("vkEnumerateInstanceExtensionProperties"))?;
    Ok(extensions.iter().any(|extension| extension.extension_name_as_c_str() == Ok(ext::debug_utils::NAME)))
}

/// Collects what the layer says of an instance, until it is dropped.
pub struct Messenger {
    debug: ext::debug_utils::Instance,
    raw: vk::DebugUtilsMessengerEXT,
    // What the callback writes to: after the messenger.
    _messages: Messages,
}

impl Messenger {
    /// One that puts what is said into `messages`.
    ///
    /// # Errors
    /// What Vulkan says.
    ///
    /// # Safety
    /// The instance is one of the entry, has the extension `VK_EXT_debug_utils`, and outlives the messenger.
    pub unsafe fn new(entry: &ash::Entry, instance: &ash::Instance, messages: Messages) -> Result<Self, Error> {
        let debug = ext::debug_utils::Instance::new(entry, instance);
        let severity = vk::DebugUtilsMessageSeverityFlagsEXT::WARNING | vk::DebugUtilsMessageSeverityFlagsEXT::ERROR;
        let create = vk::DebugUtilsMessengerCreateInfoEXT::default()
            .message_severity(severity)
            .message_type(vk::DebugUtilsMessageTypeFlagsEXT::VALIDATION)
            .pfn_user_callback(Some(collect_message))
            .user_data(Arc::as_ptr(&messages.0).cast_mut().cast());
        // SAFETY: the user data is the mutex inside `messages`, which lives as long as the messenger: it is dropped
        // after it. The callback only locks it.
        let raw = unsafe { debug.create_debug_utils_messenger(&create, None) }
            .map_err(Error::call("vkCreateDebugUtilsMessengerEXT"))?;
        Ok(Self { debug, raw, _messages: messages })
    }
}

impl Drop for Messenger {
    fn drop(&mut self) {
        // SAFETY: made from its instance, which is alive, and destroyed once.
        unsafe { self.debug.destroy_debug_utils_messenger(self.raw, None) };
    }
}

/// Puts a message of the layer into the list.
unsafe extern "system" fn collect_message(
    _severity: vk::DebugUtilsMessageSeverityFlagsEXT,
    _kind: vk::DebugUtilsMessageTypeFlagsEXT,
    data: *const vk::DebugUtilsMessengerCallbackDataEXT<'_>,
    messages: *mut c_void,
) -> vk::Bool32 {
    // SAFETY: the layer passes valid data with null-terminated (or null) text, and the user data of `Messenger::new`:
    // the mutex inside `Messages`, alive until the messenger is destroyed.
    unsafe {
        let text = (*data).message_as_c_str().map(|t| t.to_string_lossy().into_owned()).unwrap_or_default();
        let messages = &*messages.cast::<Mutex<Vec<String>>>();
        messages.lock().unwrap_or_else(PoisonError::into_inner).push(text);
    }
    vk::FALSE
}
