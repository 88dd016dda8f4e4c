//! Names of topics and services as ROS 2 has them: a namespace, private names, and remaps as users type them.
//!
//! A name that begins with `/` is what it is; `~/grid` is private to the node, `/robot1/voxelastic/grid`; any other is in its namespace, `/robot1/grid`. A remap `FROM:=TO` says these names of
//! both ends; `__ns:=/robot1` and `__node:=name` set the namespace and the name. Names of the node's own topics may be given without `~/`.

/// The name of a node, its namespace and its remaps.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Names {
    /// Begins with `/`; empty for none.
    namespace: String,
    node: String,
    remaps: Vec<(String, String)>,
}

impl Default for Names {
    fn default() -> Self {
        Self::of_node("voxelastic")
    }
}

impl Names {
    /// Of a node without a namespace and without remaps.
    pub fn of_node(node: &str) -> Self {
        Self { namespace: String::new(), node: node.to_owned(), remaps: Vec::new() }
    }

    /// Of a node, perhaps with its namespace before it (`robot1/mapper`), and remaps (`FROM:=TO`), of which the later ones win.
    ///
    /// # Errors
    /// In words: what is no name, and what is no remap.
    pub fn parse(node: &str, remaps: &[String]) -> Result<Self, String> {
        let (namespace, name) = node.rsplit_once('/').unwrap_or(("", node));
        let mut names = Self { namespace: absolute(namespace), node: name.to_owned(), remaps: Vec::new() };
        let mut rules = Vec::new();
        for remap in remaps {
            let (from, to) = remap.split_once(":=").ok_or_else(|| format!("{remap}: a remap is FROM:=TO, such as /tf:=tf or __ns:=/robot1"))?;
            // A rule may be for a node of a certain name.
            let (of, from) = from.split_once(':').map_or((None, from), |(of, from)| (Some(of), from));
            match from {
                "__ns" => names.namespace = absolute(to),
                "__node" | "__name" => names.node = to.to_owned(),
                _ => rules.push((of, from.to_owned(), to.to_owned())),
            }
        }
        for part in names.namespace.split('/').skip(1).chain([names.node.as_str()]) {
            check_word(part)?;
        }
        for (_, from, to) in &rules {
            for name in [from, to] {
                let rest = name.strip_prefix("~/").unwrap_or(name);
                rest.trim_start_matches('/').split('/').try_for_each(check_word)?;
            }
        }
        let is_meant = |of: &Option<&str>| of.is_none_or(|of| of == names.node);
        names.remaps = rules.into_iter().filter(|(of, ..)| is_meant(of)).map(|(_, from, to)| (from, to)).rev().collect();
        Ok(names)
    }

    /// The same with one more remap, which wins.
    #[must_use]
    pub fn with(mut self, from: &str, to: &str) -> Self {
        self.remaps.insert(0, (from.to_owned(), to.to_owned()));
        self
    }

    /// The name of the node, without its namespace.
    pub fn node(&self) -> &str {
        &self.node
    }

    /// The namespace, such as `/robot1`; empty for none.
    pub fn namespace(&self) -> &str {
        &self.namespace
    }

    /// The name of the node with its namespace, such as `/robot1/voxelastic`.
    pub fn full(&self) -> String {
        format!("{}/{}", self.namespace, self.node)
    }

    /// The name of a topic or a service as it is in the network.
    pub fn resolve(&self, name: &str) -> String {
        let full = self.expand(name);
        let private = name.strip_prefix("~/");
        let is_meant = |from: &String| self.expand(from) == full || private == Some(from.as_str());
        self.remaps.iter().find(|(from, _)| is_meant(from)).map_or(full, |(_, to)| self.expand(to))
    }

    /// Whether a remap names a topic or a service.
    pub fn is_remapped(&self, name: &str) -> bool {
        self.resolve(name) != self.expand(name)
    }

    fn expand(&self, name: &str) -> String {
        if let Some(private) = name.strip_prefix("~/") {
            format!("{}/{private}", self.full())
        } else if name.starts_with('/') {
            name.to_owned()
        } else {
            format!("{}/{name}", self.namespace)
        }
    }
}

/// `/robot1` of `robot1/`; nothing of `/`.
fn absolute(namespace: &str) -> String {
    let inner = namespace.trim_matches('/');
    if inner.is_empty() { String::new() } else { format!("/{inner}") }
}

/// Parts of names are made of letters, digits and single underscores.
fn check_word(word: &str) -> Result<(), String> {
    let is_word = word.chars().all(|c| c.is_ascii_alphanumeric() || c == '_') && !word.contains("__");
    let begins = word.starts_with(|c: char| c.is_ascii_alphabetic() || c == '_');
    if is_word && begins { Ok(()) } else { Err(format!("{word:?} must be letters, digits and single underscores, and begin with a letter")) }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn names(node: &str, remaps: &[&str]) -> Names {
        Names::parse(node, &remaps.iter().map(|remap| (*remap).to_owned()).collect::<Vec<_>>()).unwrap()
    }

    #[test]
    fn names_are_those_that_ros_makes() {
        let plain = names("voxelastic", &[]);
        assert_eq!(["~/grid", "/tf", "points"].map(|name| plain.resolve(name)), ["/voxelastic/grid", "/tf", "/points"]);
        assert_eq!((plain.full().as_str(), plain.namespace()), ("/voxelastic", ""));
        for spaced in [names("robot1/mapper", &[]), names("mapper", &["__ns:=/robot1"]), names("x", &["__node:=mapper", "__ns:=robot1/"])] {
            assert_eq!(["~/grid", "/tf", "tf"].map(|name| spaced.resolve(name)), ["/robot1/mapper/grid", "/tf", "/robot1/tf"]);
            assert_eq!((spaced.full().as_str(), spaced.node()), ("/robot1/mapper", "mapper"));
        }
    }

    #[test]
    fn remaps_are_as_users_type_them() {
        let names = names(
            "mapper",
            &["/tf:=tf", "tf_static:=/x", "~/grid:=/map", "octomap:=octo", "__ns:=/robot1", "other:~/path:=/p", "mapper:~/save:=keep"],
        );
        let resolved = ["/tf", "/tf_static", "~/grid", "~/octomap", "~/path", "~/save", "tf_static"].map(|name| names.resolve(name));
        assert_eq!(resolved, ["/robot1/tf", "/tf_static", "/map", "/robot1/octo", "/robot1/mapper/path", "/robot1/keep", "/x"]);
        assert!(names.is_remapped("/tf") && !names.is_remapped("/tf_static"));
    }

    #[test]
    fn what_is_no_name_is_refused() {
        let parse = |node: &str, remaps: &[&str]| Names::parse(node, &remaps.iter().map(|remap| (*remap).to_owned()).collect::<Vec<_>>());
        for node in ["", "2map", "a b", "a__b", "ä", "a/", "robot-1/mapper"] {
            assert!(parse(node, &[]).is_err(), "{node}");
        }
        assert!(parse("m", &["/tf=tf"]).unwrap_err().contains("FROM:=TO"));
        assert!(parse("m", &["/tf:=t f"]).is_err() && parse("m", &["__ns:=/9"]).is_err() && parse("_map2", &[]).is_ok());
    }
}
