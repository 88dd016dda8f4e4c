//! Text of others as it is shown: names of files, headers, topics, manifests, answers of a network. On terminals and in pages it is text, and does nothing.

use std::borrow::Cow;
use std::fmt::Write;

/// Characters of a line that are shown.
const MOST: usize = 4000;

/// Whether a character does something else than to be seen: moves the cursor, changes colours or the direction of writing, begins a line.
fn acts(c: char) -> bool {
    (c.is_control() && c != '\t')
        || matches!(c, '\u{61c}' | '\u{200e}' | '\u{200f}' | '\u{2028}'..='\u{202e}' | '\u{2060}'..='\u{206f}' | '\u{feff}' | '\u{fff9}'..='\u{fffb}')
}

/// A line of text in which nothing acts: `\u{1b}` for an escape, `\n` for a line break. Of a very long one, the beginning.
pub fn shown(line: &str) -> Cow<'_, str> {
    let is_long = line.len() > MOST && line.chars().nth(MOST).is_some();
    if !is_long && !line.chars().any(acts) {
        return Cow::Borrowed(line);
    }
    let mut text = String::new();
    for c in line.chars().take(MOST) {
        if acts(c) { text.extend(c.escape_default()) } else { text.push(c) }
    }
    if is_long {
        let _ = write!(text, " ... ({} characters)", line.chars().count());
    }
    Cow::Owned(text)
}

/// The same for text of several lines.
pub fn shown_lines(text: &str) -> String {
    text.split_inclusive('\n')
        .map(|line| line.strip_suffix('\n').map_or_else(|| shown(line).into_owned(), |line| shown(line).into_owned() + "\n"))
        .collect()
}

/// JSON that means the same, in which nothing acts.
pub fn shown_json(json: &str) -> Cow<'_, str> {
    if !json.chars().any(acts) {
        return Cow::Borrowed(json);
    }
    let mut text = String::new();
    for c in json.chars() {
        // All of them are below U+10000, and JSON has them in strings only, but for line breaks.
        let _ = if acts(c) && c != '\n' { write!(text, "\\u{:04x}", u32::from(c)) } else { write!(text, "{c}") };
    }
    Cow::Owned(text)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn nothing_acts() {
        assert!(matches!(shown("scans/ü 日本.pcd"), Cow::Borrowed(_)));
        assert_eq!(shown("a\u{1b}]0;x\u{7}\u{9b}31m\r\nERROR b\u{202e}gnp"), "a\\u{1b}]0;x\\u{7}\\u{9b}31m\\r\\nERROR b\\u{202e}gnp");
        assert_eq!(shown_lines("a\u{1b}\nb\r\n\nc"), "a\\u{1b}\nb\\r\n\nc");
        let long = shown(&"ä".repeat(10_000)).into_owned();
        assert!(long.starts_with("ääää") && long.ends_with(" ... (10000 characters)") && long.chars().count() < MOST + 40);
    }

    #[test]
    fn json_means_the_same() {
        let name = "a\u{9b}31m\u{202e}\u{1b}\n\"\\ü";
        let json = serde_json::to_string(&[name]).unwrap();
        assert!(!shown_json(&json).chars().any(acts));
        assert_eq!(serde_json::from_str::<Vec<String>>(&shown_json(&json)).unwrap(), [name]);
    }
}
