//! Cycles in a directed graph: its strongly connected components of two nodes or more, by Tarjan's algorithm.

use crate::crate_source::Reference;
use std::collections::{BTreeMap, BTreeSet};

/// Groups of files that depend on each other in a cycle, each sorted; none where all arrows go one way.
pub fn cycles(references: &[Reference]) -> Vec<Vec<String>> {
    let mut graph: BTreeMap<&str, BTreeSet<&str>> = BTreeMap::new();
    for reference in references {
        graph.entry(&reference.from).or_default().insert(&reference.to);
        graph.entry(&reference.to).or_default();
    }
    let mut search = Tarjan { graph: &graph, nodes: BTreeMap::new(), stack: Vec::new(), found: Vec::new() };
    for node in graph.keys() {
        if !search.nodes.contains_key(node) {
            search.visit(node);
        }
    }
    search.found.sort();
    search.found
}

struct Node {
    index: usize,
    /// The least index that is reached from this node over nodes on the stack.
    low: usize,
    on_stack: bool,
}

struct Tarjan<'a> {
    graph: &'a BTreeMap<&'a str, BTreeSet<&'a str>>,
    nodes: BTreeMap<&'a str, Node>,
    stack: Vec<&'a str>,
    found: Vec<Vec<String>>,
}

impl<'a> Tarjan<'a> {
    /// Visits a node and all that follow; returns its `low`.
    fn visit(&mut self, name: &'a str) -> usize {
        let index = self.nodes.len();
        self.nodes.insert(name, Node { index, low: index, on_stack: true });
        self.stack.push(name);
        let mut low = index;
        for &next in &self.graph[name] {
            low = match self.nodes.get(next) {
                None => low.min(self.visit(next)),
                Some(node) if node.on_stack => low.min(node.index),
                Some(_) => low,
            };
        }
        if let Some(node) = self.nodes.get_mut(name) {
            node.low = low;
        }
        if low == index {
            self.pop_component(name);
        }
        low
    }

    fn pop_component(&mut self, root: &str) {
        let mut component = Vec::new();
        while let Some(name) = self.stack.pop() {
            if let Some(node) = self.nodes.get_mut(name) {
                node.on_stack = false;
            }
            component.push(name.to_owned());
            if name == root {
                break;
            }
        }
        if component.len() > 1 {
            component.sort();
            self.found.push(component);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn of(arrows: &[(&str, &str)]) -> Vec<Vec<String>> {
        let reference = |&(from, to): &(&str, &str)| Reference { from: from.into(), to: to.into(), line: 1, path: String::new() };
        cycles(&arrows.iter().map(reference).collect::<Vec<_>>())
    }

    #[test]
    fn components_of_two_or_more_are_cycles() {
        assert_eq!(of(&[("a", "b"), ("b", "c"), ("a", "c")]), Vec::<Vec<String>>::new());
        assert_eq!(of(&[("a", "b"), ("b", "a"), ("b", "c")]), [["a", "b"]]);
        assert_eq!(of(&[("a", "b"), ("b", "c"), ("c", "a"), ("x", "y"), ("y", "x"), ("c", "x")]), [vec!["a", "b", "c"], vec!["x", "y"]]);
    }
}
