//! Values of a document by their paths.

/// The path of the mirror image of an entry of a symmetric or skew-symmetric matrix off its diagonal, and its
/// sign there.
pub fn mirrored(path: &str) -> Option<(String, f64)> {
    let (front, column) = path.strip_suffix(']')?.rsplit_once('[')?;
    let (front, row) = front.strip_suffix(']')?.rsplit_once('[')?;
    let matrices = [("mass", 1.0), ("stiffness", 1.0), ("coefficient", 1.0), ("gyroscopic", -1.0)];
    let (_, sign) = matrices.into_iter().find(|(matrix, _)| front.ends_with(matrix))?;
    (row != column).then(|| (format!("{front}[{column}][{row}]"), sign))
}

/// Puts a number at a path, as [`put`], and at its [mirror image](mirrored).
///
/// # Errors
/// As [`put`].
pub fn put_with_mirror(table: &mut toml::Table, path: &str, number: f64) -> Result<(), String> {
    put(table, path, toml::Value::Float(number))?;
    match mirrored(path) {
        Some((mirrored, sign)) => put(table, &mirrored, toml::Value::Float(sign * number)),
        None => Ok(()),
    }
}

/// Puts a value at a path, such as `system.damping[0].order`. Tables that are missing on the way are added; a
/// number at a list of one number takes the place of that number.
///
/// # Errors
/// Which part of the path does not exist.
pub fn put(table: &mut toml::Table, path: &str, value: toml::Value) -> Result<(), String> {
    let mut so_far = String::new();
    let parts: Vec<&str> = path.split('.').collect();
    let mut here = table;
    for (depth, part) in parts.iter().enumerate() {
        let (key, indices) = part.split_once('[').map_or((*part, ""), |(key, _)| (key, &part[key.len()..]));
        if key.is_empty() {
            return Err(format!("a key is missing behind `{so_far}`"));
        }
        so_far = if so_far.is_empty() { key.to_owned() } else { format!("{so_far}.{key}") };
        let last = depth + 1 == parts.len();
        let indices = indices_of(indices).ok_or_else(|| format!("`{indices}` is no list of indices"))?;
        if last && indices.is_empty() {
            match here.get_mut(key).and_then(lone) {
                Some(place) if is_number(&value) => *place = value,
                _ => drop(here.insert(key.to_owned(), value)),
            }
            return Ok(());
        }
        let mut place = match indices.is_empty() {
            true => here.entry(key).or_insert_with(|| toml::Value::Table(toml::Table::new())),
            false => here.get_mut(key).ok_or_else(|| format!("the scenario has no `{so_far}`"))?,
        };
        for index in indices {
            let list = place.as_array_mut().ok_or_else(|| format!("`{so_far}` is no list"))?;
            let length = list.len();
            place = list
                .get_mut(index)
                .ok_or_else(|| format!("`{so_far}` has {length} entries, with indices from 0"))?;
            so_far += &format!("[{index}]");
        }
        if last {
            match is_number(&value) && lone(place).is_some() {
                true => lone(place).into_iter().for_each(|place| *place = value.clone()),
                false => *place = value,
            }
            return Ok(());
        }
        here = place.as_table_mut().ok_or_else(|| format!("`{so_far}` has no keys"))?;
    }
    Ok(())
}

fn is_number(value: &toml::Value) -> bool {
    matches!(value, toml::Value::Float(_) | toml::Value::Integer(_))
}

/// The number of a list of one number, or of a matrix of one row and column.
fn lone(value: &mut toml::Value) -> Option<&mut toml::Value> {
    let [only] = value.as_array_mut()?.as_mut_slice() else { return None };
    if is_number(only) { Some(only) } else { lone(only) }
}

/// The number at a path of a table: also that of a list of one number.
pub fn number_at(values: &toml::Table, path: &str) -> Option<f64> {
    let mut value = value_at(values, path)?;
    while let Some([only]) = value.as_array().map(Vec::as_slice) {
        value = only;
    }
    value.as_float().or_else(|| value.as_integer().map(|whole| whole as f64))
}

/// The indices of `[0][1]`.
fn indices_of(text: &str) -> Option<Vec<usize>> {
    let mut rest = text;
    let mut indices = Vec::new();
    while !rest.is_empty() {
        let (index, behind) = rest.strip_prefix('[')?.split_once(']')?;
        indices.push(index.parse().ok()?);
        rest = behind;
    }
    Some(indices)
}

/// The value at a path of a table.
pub fn value_at<'t>(values: &'t toml::Table, path: &str) -> Option<&'t toml::Value> {
    let mut here: Option<&toml::Value> = None;
    for part in path.split('.') {
        let (key, indices) = part.split_once('[').unwrap_or((part, ""));
        let table = match here {
            None => values,
            Some(value) => value.as_table()?,
        };
        let mut value = table.get(key)?;
        for index in indices.split(['[', ']']).filter(|digits| !digits.is_empty()) {
            value = value.as_array()?.get(index.parse::<usize>().ok()?)?;
        }
        here = Some(value);
    }
    here
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn entries_have_mirror_images() {
        let image = |path: &str, sign: f64| Some((path.to_owned(), sign));
        assert_eq!(mirrored("system.mass[0][1]"), image("system.mass[1][0]", 1.0));
        let coefficient = mirrored("system.damping[3].coefficient[2][0]");
        assert_eq!(coefficient, image("system.damping[3].coefficient[0][2]", 1.0));
        assert_eq!(mirrored("system.gyroscopic[0][1]"), image("system.gyroscopic[1][0]", -1.0));
        for path in ["system.mass[1][1]", "system.mass[1]", "system.damping[0].order", "input.samples[0][1]"]
        {
            assert_eq!(mirrored(path), None, "{path}");
        }
    }

    #[test]
    fn values_are_put_where_paths_lead() {
        let mut table: toml::Table = "a = { list = [1.0, [2.0, 3.0]] }\nb = [{ c = 1 }]".parse().unwrap();
        let four = || toml::Value::Float(4.0);
        put(&mut table, "a.list[1][0]", four()).unwrap();
        put(&mut table, "b[0].c", four()).unwrap();
        put(&mut table, "new.key", four()).unwrap();
        // A list of one number is named with or without its index.
        let mut lists: toml::Table = "one = [1.0]\nmatrix = [[2.0]]\ntwo = [1.0, 2.0]".parse().unwrap();
        for path in ["one", "matrix", "matrix[0]", "two"] {
            put(&mut lists, path, four()).unwrap();
        }
        let expected: toml::Table = "one = [4.0]\nmatrix = [[4.0]]\ntwo = 4.0".parse().unwrap();
        assert_eq!(lists, expected);
        let numbers = ["one", "one[0]", "matrix"].map(|path| number_at(&lists, path));
        assert_eq!(numbers, [Some(4.0); 3]);
        assert_eq!(table["a"]["list"][1][0], four());
        assert_eq!(table["b"][0]["c"], four());
        assert_eq!(table["new"]["key"], four());
        for (path, said) in [
            ("a.list[2]", "`a.list` has 2 entries"),
            ("b[1].c", "`b` has 1 entries"),
            ("d[0]", "the scenario has no `d`"),
            ("a.list.x", "`a.list` has no keys"),
            ("a.list[x]", "no list of indices"),
            ("a..b", "a key is missing"),
        ] {
            let error = put(&mut table, path, four()).unwrap_err();
            assert!(error.contains(said), "{path}: {error}");
        }
    }
}
