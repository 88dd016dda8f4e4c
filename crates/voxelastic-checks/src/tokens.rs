//! Rust source as tokens: without comments, literals and code that only tests compile.

/// An identifier, `::`, or a single character of punctuation.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Token {
    /// The token's text.
    pub text: String,
    /// Line in the file, from 1.
    pub line: usize,
}

impl Token {
    /// Whether this is an identifier or a keyword.
    pub fn is_identifier(&self) -> bool {
        self.text.starts_with(|c: char| c == '_' || c.is_alphabetic())
    }
}

/// Splits source text into tokens. Comments, lifetimes and literals are left out.
pub fn tokenize(source: &str) -> Vec<Token> {
    Scanner { rest: source, line: 1, tokens: Vec::new() }.run()
}

struct Scanner<'a> {
    rest: &'a str,
    line: usize,
    tokens: Vec<Token>,
}

impl Scanner<'_> {
    fn run(mut self) -> Vec<Token> {
        while let Some(c) = self.rest.chars().next() {
            if self.rest.starts_with("//") {
                self.skip(self.rest.find('\n').unwrap_or(self.rest.len()));
            } else if self.rest.starts_with("/*") {
                self.skip(block_comment(self.rest));
            } else if let Some(length) = string_literal(self.rest) {
                self.skip(length);
            } else if c == '\'' {
                self.skip(character_or_lifetime(self.rest));
            } else if c == '_' || c.is_alphabetic() {
                self.identifier();
            } else if c.is_ascii_digit() {
                self.skip(self.rest.find(|c: char| c != '_' && !c.is_alphanumeric()).unwrap_or(self.rest.len()));
            } else if self.rest.starts_with("::") {
                self.push(2);
            } else if c.is_whitespace() {
                self.skip(c.len_utf8());
            } else {
                self.push(c.len_utf8());
            }
        }
        self.tokens
    }

    fn identifier(&mut self) {
        if self.rest.starts_with("r#") {
            self.skip(2);
        }
        self.push(self.rest.find(|c: char| c != '_' && !c.is_alphanumeric()).unwrap_or(self.rest.len()));
    }

    fn push(&mut self, length: usize) {
        self.tokens.push(Token { text: self.rest[..length].to_owned(), line: self.line });
        self.skip(length);
    }

    fn skip(&mut self, length: usize) {
        let (skipped, rest) = self.rest.split_at(length);
        self.line += skipped.matches('\n').count();
        self.rest = rest;
    }
}

/// Length of the block comment at the start of the text; block comments nest.
fn block_comment(text: &str) -> usize {
    let (mut at, mut depth) = (2, 1);
    while depth > 0 && at < text.len() {
        let rest = &text.as_bytes()[at..];
        if rest.starts_with(b"/*") {
            (at, depth) = (at + 2, depth + 1);
        } else if rest.starts_with(b"*/") {
            (at, depth) = (at + 2, depth - 1);
        } else {
            at += 1;
        }
    }
    at
}

/// Length of the string literal at the start of the text, if there is one: plain, byte, C or raw.
fn string_literal(text: &str) -> Option<usize> {
    let prefix = ["br", "cr", "b", "c", "r", ""].into_iter().find(|p| {
        let after = text.strip_prefix(p);
        after.is_some_and(|t| t.starts_with('"') || p.ends_with('r') && t.trim_start_matches('#').starts_with('"') && t.starts_with('#'))
    })?;
    let body = &text[prefix.len()..];
    if prefix.ends_with('r') {
        let hashes = body.len() - body.trim_start_matches('#').len();
        let end = format!("\"{}", "#".repeat(hashes));
        let start = hashes + 1;
        return Some(prefix.len() + body[start..].find(&end).map_or(body.len(), |at| start + at + end.len()));
    }
    let mut escaped = false;
    for (at, c) in body.char_indices().skip(1) {
        match c {
            _ if escaped => escaped = false,
            '\\' => escaped = true,
            '"' => return Some(prefix.len() + at + 1),
            _ => (),
        }
    }
    Some(text.len())
}

/// Length of the character literal or lifetime at the start of the text.
fn character_or_lifetime(text: &str) -> usize {
    let mut characters = text.char_indices().skip(1);
    match characters.next() {
        Some((_, '\\')) => {
            characters.next(); // what is escaped, perhaps a quote
            characters.find(|&(_, c)| c == '\'').map_or(text.len(), |(at, _)| at + 1)
        }
        Some((_, c)) => match characters.next() {
            Some((at, '\'')) => at + 1,
            _ if c == '_' || c.is_alphabetic() => 1 + text[1..].find(|c: char| c != '_' && !c.is_alphanumeric()).unwrap_or(text.len() - 1),
            _ => 1,
        },
        None => 1,
    }
}

/// Removes items with `#[cfg(test)]` or `#[cfg(all(test, ..))]`.
pub fn without_tests(tokens: &[Token]) -> Vec<Token> {
    let mut kept = Vec::with_capacity(tokens.len());
    let mut at = 0;
    while at < tokens.len() {
        match attribute(tokens, at) {
            Some(end) if is_for_tests(&tokens[at..end]) => at = item_end(tokens, end),
            Some(end) => {
                kept.extend_from_slice(&tokens[at..end]);
                at = end;
            }
            None => {
                kept.push(tokens[at].clone());
                at += 1;
            }
        }
    }
    kept
}

/// Where the outer attribute that starts at `at` ends, if one does.
fn attribute(tokens: &[Token], at: usize) -> Option<usize> {
    let starts = tokens[at].text == "#" && tokens.get(at + 1)?.text == "[";
    starts.then(|| closing(tokens, at + 1))
}

fn is_for_tests(attribute: &[Token]) -> bool {
    let text: String = attribute.iter().map(|t| t.text.as_str()).collect();
    text == "#[cfg(test)]" || text.starts_with("#[cfg(all(test,") || text == "#[test]"
}

/// The index after the bracket that closes the one at `open`.
fn closing(tokens: &[Token], open: usize) -> usize {
    let mut depth = 0usize;
    for (at, token) in tokens.iter().enumerate().skip(open) {
        match token.text.as_str() {
            "(" | "[" | "{" => depth += 1,
            ")" | "]" | "}" => depth = depth.saturating_sub(1),
            _ => (),
        }
        if depth == 0 {
            return at + 1;
        }
    }
    tokens.len()
}

/// The index after the item, statement or field that starts at `at`.
fn item_end(tokens: &[Token], mut at: usize) -> usize {
    const ITEMS: [&str; 16] = [
        "pub",
        "fn",
        "mod",
        "use",
        "struct",
        "enum",
        "union",
        "impl",
        "trait",
        "const",
        "static",
        "type",
        "unsafe",
        "extern",
        "async",
        "macro_rules",
    ];
    while let Some(end) = tokens.get(at).and_then(|_| attribute(tokens, at)) {
        at = end;
    }
    let is_item = tokens.get(at).is_some_and(|t| ITEMS.contains(&t.text.as_str()));
    while at < tokens.len() {
        match tokens[at].text.as_str() {
            "{" => return closing(tokens, at),
            "(" | "[" => at = closing(tokens, at),
            ";" => return at + 1,
            "," if !is_item => return at + 1,
            "}" => return at,
            _ => at += 1,
        }
    }
    at
}

#[cfg(test)]
mod tests {
    use super::*;

    fn texts(source: &str) -> String {
        tokenize(source).iter().map(|t| t.text.as_str()).collect::<Vec<_>>().join(" ")
    }

    #[test]
    fn comments_literals_and_lifetimes_are_no_tokens() {
        assert_eq!(texts("a // b\n/* c /* d */ e */ f"), "a f");
        assert_eq!(texts(r##"x("a\"b", r#"c"d"#, b"e", 'f', '\'', '"') y"##), "x ( , , , , , ) y");
        assert_eq!(texts("fn f<'a>(x: &'a str) -> crate::X"), "fn f < > ( x : & str ) - > crate :: X");
        assert_eq!(texts("r#type::b 0x1f_u8 1.5e3"), "type :: b .");
        assert_eq!(tokenize("a\n\"x\ny\"\nb")[1].line, 4);
    }

    #[test]
    fn code_for_tests_is_removed() {
        let kept = |source: &str| without_tests(&tokenize(source)).iter().map(|t| t.text.clone()).collect::<Vec<_>>().join(" ");
        assert_eq!(kept("a; #[cfg(test)] mod tests { fn f() { b } } c"), "a ; c");
        assert_eq!(kept("#[cfg(test)] #[allow(x)] mod tests; c"), "c");
        assert_eq!(kept("struct A { #[cfg(test)] b: [u8; 2], c: u8 }"), "struct A { c : u8 }");
        assert_eq!(kept("#[cfg(test)] pub fn f<A, B>(a: A) -> B { d } e"), "e");
        assert_eq!(kept("#[cfg(not(test))] fn f() {}"), "# [ cfg ( not ( test ) ) ] fn f ( ) { }");
    }
}
