//! Shaders with lines that are left out: `#if NAME`, `#elif NAME`, `#else` and `#endif`, nested.
//!
//! WGSL has no preprocessor, and an input or output of a shader cannot be switched off by a constant.

/// The lines of a source whose conditions hold.
pub(crate) fn filled(source: &str, is_set: &dyn Fn(&str) -> bool) -> String {
    // of each open condition: whether this branch is kept, and whether one has been
    let mut open: Vec<(bool, bool)> = Vec::new();
    let mut kept = String::with_capacity(source.len());
    for line in source.lines() {
        let mut words = line.split_whitespace();
        match (words.next(), words.next()) {
            (Some("#if"), Some(name)) => {
                let holds = is_set(name);
                open.push((holds, holds));
            }
            (Some("#elif"), Some(name)) => {
                let (branch, any) = open.last_mut().expect("an #if came before");
                *branch = !*any && is_set(name);
                *any |= *branch;
            }
            (Some("#else"), None) => {
                let (branch, any) = open.last_mut().expect("an #if came before");
                *branch = !*any;
            }
            (Some("#endif"), None) => {
                open.pop().expect("an #if came before");
            }
            _ if open.iter().all(|(branch, _)| *branch) => {
                kept.push_str(line);
                kept.push('\n');
            }
            _ => {}
        }
    }
    assert!(open.is_empty(), "every #if ends");
    kept
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lines_are_kept_where_all_their_conditions_hold() {
        let source =
            "a\n#if X\nb\n  #if Y\nc\n  #else\nd\n  #endif\n#elif Y\ne\n#else\nf\n#endif\ng";
        for (set, kept) in [("", "afg"), ("X", "abdg"), ("Y", "aeg"), ("XY", "abcg")] {
            let lines = filled(source, &|name| set.contains(name));
            assert_eq!(lines.replace('\n', ""), kept, "{set:?}");
        }
    }
}
