//! Colours of vertices that no image shows: those of their neighbours.

/// Edges over which colours spread.
const REACH: usize = 4;

/// Fills in missing colours from vertices in the same triangles, over up to [`REACH`] edges; returns how many were filled in.
pub(crate) fn spread(colours: &mut [Option<[f32; 3]>], triangles: &[[u32; 3]]) -> usize {
    let mut filled = 0;
    let mut open: Vec<[u32; 3]> = triangles.to_vec();
    for _ in 0..REACH {
        open.retain(|t| t.iter().any(|v| colours[*v as usize].is_none()));
        let mut found: Vec<(u32, [f32; 3])> = Vec::new();
        for t in &open {
            for k in 0..3 {
                if colours[t[k] as usize].is_none() {
                    found.extend([t[(k + 1) % 3], t[(k + 2) % 3]].iter().filter_map(|n| Some((t[k], colours[*n as usize]?))));
                }
            }
        }
        if found.is_empty() {
            break;
        }
        found.sort_by_key(|f| f.0);
        for of_one in found.chunk_by(|a, b| a.0 == b.0) {
            let mean = |k: usize| of_one.iter().map(|f| f.1[k]).sum::<f32>() / of_one.len() as f32;
            colours[of_one[0].0 as usize] = Some(std::array::from_fn(mean));
            filled += 1;
        }
    }
    filled
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn colours_spread_over_a_few_edges() {
        // A strip of triangles: vertex i shares triangles with i - 2 to i + 2.
        let triangles: Vec<[u32; 3]> = (0..40).map(|i| [i, i + 1, i + 2]).collect();
        let mut colours = vec![None; 42];
        colours[0] = Some([0.5; 3]);
        assert_eq!(spread(&mut colours, &triangles), 8);
        assert!(colours[8] == Some([0.5; 3]) && colours[9].is_none());
        assert_eq!(spread(&mut [None; 42], &triangles), 0);
    }
}
