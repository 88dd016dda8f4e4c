//! Encoders for test files that share no code with the library.

/// A field: name, PCD type letter, bytes per number, numbers per point.
#[derive(Clone, Debug)]
pub struct Field(pub &'static str, pub char, pub usize, pub usize);

impl Field {
    fn put(&self, value: f64, big_endian: bool, out: &mut Vec<u8>) {
        let mut bytes = match (self.1, self.2) {
            ('F', 4) => (value as f32).to_le_bytes().to_vec(),
            ('F', 8) => value.to_le_bytes().to_vec(),
            ('I', 1) => (value as i8).to_le_bytes().to_vec(),
            ('I', 2) => (value as i16).to_le_bytes().to_vec(),
            ('I', 4) => (value as i32).to_le_bytes().to_vec(),
            ('U', 1) => (value as u8).to_le_bytes().to_vec(),
            ('U', 2) => (value as u16).to_le_bytes().to_vec(),
            ('U', 4) => (value as u32).to_le_bytes().to_vec(),
            ('U', 8) => (value as u64).to_le_bytes().to_vec(),
            other => panic!("{other:?}"),
        };
        if big_endian {
            bytes.reverse();
        }
        out.extend(bytes);
    }

    fn text(&self, value: f64) -> String {
        if self.1 == 'F' && self.2 == 4 { (value as f32).to_string() } else { value.to_string() }
    }

    fn ply_type(&self) -> &'static str {
        match (self.1, self.2) {
            ('F', 4) => "float",
            ('F', 8) => "double",
            ('I', 1) => "char",
            ('I', 2) => "short",
            ('I', 4) => "int",
            ('U', 1) => "uchar",
            ('U', 2) => "ushort",
            ('U', 4) => "uint",
            other => panic!("{other:?}"),
        }
    }
}

/// Points as rows with one number per field; fields of several numbers repeat it.
#[derive(Debug)]
pub struct Table {
    pub fields: Vec<Field>,
    pub rows: Vec<Vec<f64>>,
    pub width: usize,
    pub height: usize,
}

impl Table {
    fn list(&self, what: impl Fn(&Field) -> String) -> String {
        self.fields.iter().map(what).collect::<Vec<_>>().join(" ")
    }

    /// The numbers of a row with repeats.
    fn numbers<'a>(&'a self, row: &'a [f64]) -> impl Iterator<Item = (&'a Field, f64)> {
        self.fields.iter().zip(row).flat_map(|(f, v)| std::iter::repeat_n((f, *v), f.3))
    }

    pub fn pcd(&self, data: &str) -> Vec<u8> {
        let mut out = format!(
            "# .PCD v.7\nVERSION .7\nFIELDS {}\nSIZE {}\nTYPE {}\nCOUNT {}\nWIDTH {}\nHEIGHT {}\nVIEWPOINT 0 0 0 1 0 0 0\nPOINTS {}\nDATA {data}\n",
            self.list(|f| f.0.into()),
            self.list(|f| f.2.to_string()),
            self.list(|f| f.1.into()),
            self.list(|f| f.3.to_string()),
            self.width,
            self.height,
            self.rows.len(),
        )
        .into_bytes();
        match data {
            "ascii" => out.extend(self.lines()),
            "binary" => self.rows.iter().flat_map(|r| self.numbers(r)).for_each(|(f, v)| f.put(v, false, &mut out)),
            _ => {
                let mut body = Vec::new();
                for (k, field) in self.fields.iter().enumerate() {
                    for row in &self.rows {
                        (0..field.3).for_each(|_| field.put(row[k], false, &mut body));
                    }
                }
                let packed = lzf(&body);
                out.extend((packed.len() as u32).to_le_bytes());
                out.extend((body.len() as u32).to_le_bytes());
                out.extend(packed);
            }
        }
        out
    }

    /// As PLY, with an element before and one after the vertices.
    pub fn ply(&self, format: &str) -> Vec<u8> {
        let properties: String = self.fields.iter().map(|f| format!("property {} {}\n", f.ply_type(), f.0)).collect();
        let mut out = format!(
            "ply\nformat {format} 1.0\ncomment made by a test\nelement station 2\nproperty list uchar short path\nproperty float height\n\
             element vertex {}\n{properties}element face 1\nproperty list uchar int vertex_indices\nend_header\n",
            self.rows.len()
        )
        .into_bytes();
        if format == "ascii" {
            out.extend(b"2 7 8 1.5\n0 2.5\n");
            out.extend(self.lines());
            out.extend(b"3 0 0 0\n");
            return out;
        }
        let big_endian = format == "binary_big_endian";
        let put = |letter, size, value: f64, out: &mut Vec<u8>| Field("", letter, size, 1).put(value, big_endian, out);
        for path in [&[7.0, 8.0][..], &[]] {
            out.push(path.len() as u8);
            path.iter().for_each(|v| put('I', 2, *v, &mut out));
            put('F', 4, 1.5, &mut out);
        }
        self.rows.iter().flat_map(|r| self.numbers(r)).for_each(|(f, v)| f.put(v, big_endian, &mut out));
        out.push(3);
        (0..3).for_each(|_| put('I', 4, 0.0, &mut out));
        out
    }

    fn lines(&self) -> Vec<u8> {
        let line = |row: &Vec<f64>| self.numbers(row).map(|(f, v)| f.text(v)).collect::<Vec<_>>().join(" ") + "\n";
        self.rows.iter().map(line).collect::<String>().into_bytes()
    }
}

/// LZF by greedy search through a table of the last place of each three bytes.
pub fn lzf(input: &[u8]) -> Vec<u8> {
    let (mut out, mut literals, mut last) = (Vec::new(), Vec::new(), std::collections::HashMap::new());
    let flush = |literals: &mut Vec<u8>, out: &mut Vec<u8>| {
        for chunk in literals.chunks(32) {
            out.push(chunk.len() as u8 - 1);
            out.extend(chunk);
        }
        literals.clear();
    };
    let mut at = 0;
    while at < input.len() {
        let found = input.get(at..at + 3).and_then(|key| last.insert(key, at)).filter(|from| at - from <= 8192);
        let Some(from) = found else {
            literals.push(input[at]);
            at += 1;
            continue;
        };
        let length = (3..=264.min(input.len() - at)).rev().find(|l| (0..*l).all(|k| input[from + k] == input[at + k])).unwrap_or(3);
        flush(&mut literals, &mut out);
        let (distance, code) = (at - from - 1, length - 2);
        if code < 7 {
            out.push((code << 5 | distance >> 8) as u8);
        } else {
            out.push((7 << 5 | distance >> 8) as u8);
            out.push((code - 7) as u8);
        }
        out.push(distance as u8);
        at += length;
    }
    flush(&mut literals, &mut out);
    out
}
