//! Unpacking LZF, the compression of `binary_compressed` files.
//!
//! A control byte below 32 announces that many literal bytes, plus one. Any other is a copy of bytes already unpacked:
//! its upper three bits are the length less two (seven: add the next byte), its lower five and the next byte the
//! distance less one.

/// Where packed data breaks the rules.
#[derive(Debug, PartialEq, Eq)]
pub(super) struct Damage {
    /// Byte of the packed data.
    pub(super) offset: usize,
    pub(super) problem: &'static str,
}

/// Unpacks `packed` into exactly `expected` bytes. Memory grows with what is really unpacked, not with the claim.
pub(super) fn unpack(packed: &[u8], expected: usize) -> Result<Vec<u8>, Damage> {
    let mut out = Vec::with_capacity(expected.min(packed.len().saturating_mul(4)));
    let mut at = 0;
    while at < packed.len() {
        let start = at;
        let damage = |problem| Damage { offset: start, problem };
        let control = usize::from(packed[at]);
        at += 1;
        if control < 32 {
            let literals = packed.get(at..at + control + 1).ok_or(damage("it ends inside a literal"))?;
            out.extend_from_slice(literals);
            at += control + 1;
        } else {
            let mut byte = || {
                let b = packed.get(at).copied().map(usize::from).ok_or(damage("it ends inside a copy"));
                at += 1;
                b
            };
            let length = if control >> 5 == 7 { byte()? + 9 } else { (control >> 5) + 2 };
            let distance = ((control & 31) << 8 | byte()?) + 1;
            let from = out.len().checked_sub(distance).ok_or(damage("it copies from before the beginning"))?;
            if distance >= length {
                out.extend_from_within(from..from + length);
            } else {
                // The copy overlaps what it writes: a pattern repeats.
                (from..from + length).for_each(|k| out.push(out[k]));
            }
        }
        if out.len() > expected {
            return Err(damage("it unpacks to more than the header claims"));
        }
    }
    if out.len() == expected { Ok(out) } else { Err(Damage { offset: packed.len(), problem: "it unpacks to less than the header claims" }) }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn literals_copies_and_patterns() {
        assert_eq!(unpack(&[2, b'a', b'b', b'c'], 3).unwrap(), b"abc");
        assert_eq!(unpack(&[2, b'a', b'b', b'c', 1 << 5, 2], 6).unwrap(), b"abcabc");
        assert_eq!(unpack(&[0, b'x', 7 << 5, 3, 0], 13).unwrap(), [b'x'; 13]);
        assert!(unpack(&[], 0).unwrap().is_empty());
    }

    #[test]
    fn damage_is_located() {
        let problem = |packed: &[u8], expected| unpack(packed, expected).unwrap_err().offset;
        assert_eq!(problem(&[5, 1, 2], 6), 0);
        assert_eq!(problem(&[0, 1, 32], 6), 2);
        assert_eq!(problem(&[0, 1, 32, 1], 6), 2);
        assert_eq!(problem(&[0, 1, 32, 0], 3), 2);
        assert_eq!(problem(&[0, 1], 2), 2);
    }
}
