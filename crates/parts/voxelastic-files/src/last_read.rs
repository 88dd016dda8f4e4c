//! The file that was read last, for the message of a program that ends without memory: it must be said without asking for any.

use std::path::Path;
use std::sync::Mutex;

/// Bytes of a path that are kept.
const LONGEST: usize = 512;

static LAST: Mutex<([u8; LONGEST], usize)> = Mutex::new(([0; LONGEST], 0));

/// Notes that a file is read.
pub fn note_read(path: &Path) {
    if let Ok(mut last) = LAST.lock() {
        let (bytes, length) = &mut *last;
        *length = 0;
        // What would act on a terminal, and what is not ASCII, is a question mark.
        for (to, from) in bytes.iter_mut().zip(path.as_os_str().as_encoded_bytes()) {
            *to = if from.is_ascii_graphic() || *from == b' ' { *from } else { b'?' };
            *length += 1;
        }
    }
}

/// Calls `say` with it, if there was one. Asks for no memory and waits for nobody.
pub fn last_read(say: impl FnOnce(&[u8])) {
    if let Ok(last) = LAST.try_lock()
        && let Some(path) = last.0.get(..last.1).filter(|path| !path.is_empty())
    {
        say(path);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_last_file_is_known() {
        note_read(Path::new(&"x".repeat(9000)));
        last_read(|path| assert_eq!(path.len(), LONGEST));
        note_read(Path::new("a\u{1b}b c.e57"));
        last_read(|path| assert_eq!(path, b"a?b c.e57"));
    }
}
