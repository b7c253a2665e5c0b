//! Lines on the terminal. `println!` and `eprintln!` panic where nobody reads; these do not.

use std::fmt::Arguments;
use std::io::{self, ErrorKind, Write as _};
use std::sync::Mutex;

use crate::error::Error;

/// The first failure of a write to standard output that was not a reader who has had enough.
static FAILURE: Mutex<Option<io::Error>> = Mutex::new(None);

/// Prints a line to standard output. A closed pipe is no fault; any other is reported by [`finish`].
#[macro_export]
macro_rules! say {
    ($($text:tt)*) => { $crate::print::say(::std::format_args!($($text)*)) };
}

/// Prints a line to standard error; where that is closed, there is nobody to tell.
#[macro_export]
macro_rules! tell {
    ($($text:tt)*) => { $crate::print::tell(::std::format_args!($($text)*)) };
}

/// As [`say!`](crate::say).
pub fn say(line: Arguments) {
    if let Err(error) = writeln!(io::stdout(), "{line}") {
        keep(error);
    }
}

/// As [`tell!`](crate::tell).
pub fn tell(line: Arguments) {
    let _ = writeln!(io::stderr(), "{line}");
}

/// Checks that all that was said to standard output arrived, as far as somebody read it.
///
/// # Errors
/// [`Error::Print`] with what the system said first.
pub fn finish() -> Result<(), Error> {
    if let Err(error) = io::stdout().flush() {
        keep(error);
    }
    match FAILURE.lock().ok().and_then(|mut failure| failure.take()) {
        Some(source) => Err(Error::Print { source }),
        None => Ok(()),
    }
}

fn keep(error: io::Error) {
    if error.kind() == ErrorKind::BrokenPipe {
        return;
    }
    if let Ok(mut failure) = FAILURE.lock() {
        failure.get_or_insert(error);
    }
}
