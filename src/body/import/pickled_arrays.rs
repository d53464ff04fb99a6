//! Arrays in pickles: NumPy's, and those inside chumpy's and SciPy's sparse objects.

use std::rc::Rc;

use super::pickle::{Object, Value};
use crate::npz::{Array, Npz};

/// The arrays that a pickled dictionary has under `names`, with at most `max_values` values together: a block of bytes may lie
/// under many keys. Nothing else is looked at; models hold tables of joints' names and settings beside the arrays. Of what is no
/// array of numbers the reason is kept.
pub fn dictionary(value: &Value, names: &[&str], max_values: usize) -> Result<Npz, String> {
    let entries = match value {
        Value::Object(object) => object.borrow().state.clone(),
        _ => value.clone(),
    };
    if !matches!(entries, Value::Dict(_)) {
        return Err("not a dictionary".to_owned());
    }
    let mut npz = Npz::default();
    let mut left = max_values;
    for &name in names {
        let Some(value) = entries.get(name).filter(|value| !matches!(value, Value::None)) else { continue };
        match array(&value, left, 0) {
            Ok(array) => {
                left -= array.data.len();
                npz.arrays.insert(name.to_owned(), array);
            }
            Err(reason) => _ = npz.skipped.insert(name.to_owned(), reason),
        }
    }
    Ok(npz)
}

/// The class or function that the object comes from.
fn class(object: &Object) -> String {
    match &object.callable {
        // Protocols 0 and 1 build objects through a helper whose first argument is the class.
        Value::Global(name) if name.ends_with("._reconstructor") => match object.args.items().as_deref() {
            Some([Value::Global(class), ..]) => class.to_string(),
            _ => name.to_string(),
        },
        Value::Global(name) => name.to_string(),
        _ => String::new(),
    }
}

/// Arrays lie in objects that lie in objects, a few deep; an object may also hold itself.
const MAX_DEPTH: usize = 8;

/// An array of at most `max_values` values.
fn array(value: &Value, max_values: usize, depth: usize) -> Result<Array, String> {
    if depth > MAX_DEPTH {
        return Err("objects within objects without an end".to_owned());
    }
    let Value::Object(object) = value else { return numbers(value, max_values) };
    let object = object.borrow();
    let class = class(&object);
    if class.ends_with("multiarray._reconstruct") {
        return numpy(&object.state, max_values);
    }
    if class.ends_with("numeric._frombuffer") {
        let args = object.args.items().unwrap_or_default();
        let [data, dtype, shape, order] = &args[..] else { return Err("a buffer without a shape".to_owned()) };
        let fortran = order.string().as_deref() == Some("F");
        return decode(data, dtype, shape, fortran, max_values);
    }
    let field = |name: &str| match object.state.get(name) {
        Some(value) => array(&value, max_values, depth + 1),
        None => Err(format!("an object of {class} without `{name}`, expected numbers")),
    };
    if class.starts_with("scipy.sparse") {
        return sparse(&class, &object.state, max_values, field);
    }
    if class == "chumpy.reordering.Select" {
        return select(&object.state, field);
    }
    // chumpy keeps the numbers of a constant in `x`.
    field("x")
}

/// What chumpy makes of `a[…]`: the values of `a` in C order, those at `idxs`, in `preferred_shape`.
fn select(state: &Value, field: impl Fn(&str) -> Result<Array, String>) -> Result<Array, String> {
    let (from, at) = (field("a")?.data, field("idxs")?.data);
    let shape = state.get("preferred_shape").and_then(|shape| sizes(&shape)).ok_or("a selection without a shape")?;
    if shape.iter().try_fold(1usize, |a, &n| a.checked_mul(n)) != Some(at.len()) {
        return Err(format!("a selection of {} values, expected those of shape {shape:?}", at.len()));
    }
    let value = |&i: &f64| if i < 0.0 { None } else { from.get(i as usize).copied() };
    let values = at.iter().map(value).collect::<Option<Vec<f64>>>();
    let values = values.ok_or_else(|| format!("a selection of values that are not among the {}", from.len()))?;
    Ok(Array::new(&shape, values))
}

/// A list of numbers.
fn numbers(value: &Value, max_values: usize) -> Result<Array, String> {
    let number = |value: &Value| match value {
        Value::Float(number) => Some(*number),
        other => other.int().map(|number| number as f64),
    };
    let data = value.items().and_then(|items| items.iter().map(number).collect::<Option<Vec<f64>>>());
    let data = data.ok_or_else(|| format!("{value:?}, expected numbers"))?;
    if data.len() > max_values {
        return Err(format!("{value:?} is too large"));
    }
    Ok(Array::new(&[data.len()], data))
}

/// `(version, shape, dtype, is Fortran order, data)`
fn numpy(state: &Value, max_values: usize) -> Result<Array, String> {
    let state = state.items().unwrap_or_default();
    let [_, shape, dtype, fortran, data] = &state[..] else { return Err("a NumPy array without data".to_owned()) };
    decode(data, dtype, shape, fortran.int() == Some(1), max_values)
}

/// Bytes; or the call that Python 3 writes for them in the old protocols, `_codecs.encode(text, 'latin1')`.
fn bytes(value: &Value) -> Option<Rc<Vec<u8>>> {
    match value {
        Value::Bytes(bytes) => Some(bytes.clone()),
        Value::Object(object) if class(&object.borrow()) == "_codecs.encode" => {
            let text = object.borrow().args.items()?.first()?.string()?;
            text.chars().map(|c| u8::try_from(u32::from(c)).ok()).collect::<Option<_>>().map(Rc::new)
        }
        _ => None,
    }
}

/// A tuple of sizes.
fn sizes(shape: &Value) -> Option<Vec<usize>> {
    shape.items()?.iter().map(|n| n.int().and_then(|n| n.try_into().ok())).collect()
}

fn decode(data: &Value, dtype: &Value, shape: &Value, fortran: bool, max_values: usize) -> Result<Array, String> {
    let Value::Object(dtype) = dtype else { return Err("an array without a type".to_owned()) };
    let dtype = dtype.borrow();
    let kind = dtype.args.items().and_then(|args| args.first()?.string()).unwrap_or_default();
    let order = dtype.state.items().and_then(|state| state.get(1)?.string()).unwrap_or_default();
    let big = order == ">" || kind.starts_with('>');
    let kind = kind.trim_start_matches(['<', '>', '|', '=']);

    let shape = sizes(shape).ok_or("an array without a shape")?;
    let count = shape.iter().try_fold(1usize, |a, &n| a.checked_mul(n)).filter(|&n| n <= max_values);
    let count = count.ok_or_else(|| format!("shape {shape:?} is too large"))?;
    let data = bytes(data).ok_or_else(|| format!("type {kind}, expected numbers"))?;

    macro_rules! numbers {
        ($t:ty) => {{
            const SIZE: usize = std::mem::size_of::<$t>();
            let chunks = data.as_chunks::<SIZE>().0;
            // Before anything is made of them: data may be longer than its shape tells.
            if chunks.len() != count {
                return Err(format!("{} values, expected {count} for shape {shape:?}", chunks.len()));
            }
            chunks.iter().map(|&c| if big { <$t>::from_be_bytes(c) } else { <$t>::from_le_bytes(c) } as f64).collect()
        }};
    }
    let values: Vec<f64> = match kind {
        "f8" => numbers!(f64),
        "f4" => numbers!(f32),
        "i8" => numbers!(i64),
        "i4" => numbers!(i32),
        "i2" => numbers!(i16),
        "u8" => numbers!(u64),
        "u4" => numbers!(u32),
        "u2" => numbers!(u16),
        "i1" => numbers!(i8),
        "u1" | "b1" => numbers!(u8),
        _ => return Err(format!("type {kind}, expected numbers")),
    };
    Ok(if fortran { Array::from_fortran(&shape, &values) } else { Array::new(&shape, values) })
}

/// A SciPy sparse matrix in one of the formats csc, csr and coo, made dense; entries given twice add up.
fn sparse(
    class: &str,
    state: &Value,
    max_values: usize,
    field: impl Fn(&str) -> Result<Array, String>,
) -> Result<Array, String> {
    let shape = state.get("_shape").or_else(|| state.get("shape")).and_then(|shape| sizes(&shape));
    let Some(&[rows, columns]) = shape.as_deref() else { return Err("a sparse matrix without a shape".to_owned()) };
    let size = rows.checked_mul(columns).filter(|&n| n <= max_values);
    let size = size.ok_or_else(|| format!("shape [{rows}, {columns}] is too large"))?;
    let data = field("data")?.data;
    let by_column = class.ends_with("csc_matrix") || class.ends_with("csc_array");
    let (i, j) = if class.ends_with("coo_matrix") || class.ends_with("coo_array") {
        (field("row")?.usize(), field("col")?.usize())
    } else if by_column || class.ends_with("csr_matrix") || class.ends_with("csr_array") {
        let starts = field("indptr")?.usize();
        // Starts that went back would name the data many times over.
        if !starts.is_sorted() {
            return Err("a sparse matrix whose lines overlap".to_owned());
        }
        let lines = starts.windows(2).enumerate();
        let major = lines.flat_map(|(line, ends)| (ends[0]..ends[1].min(data.len())).map(move |_| line)).collect();
        let minor = field("indices")?.usize();
        if by_column { (minor, major) } else { (major, minor) }
    } else {
        return Err(format!("sparse format {class}, expected csc, csr or coo"));
    };
    if i.len() != data.len() || j.len() != data.len() {
        return Err("a sparse matrix whose indices do not fit its data".to_owned());
    }
    let mut dense = vec![0.0; size];
    for ((i, j), value) in i.into_iter().zip(j).zip(data) {
        if i >= rows || j >= columns {
            return Err(format!("a sparse matrix with an entry at [{i}, {j}] of [{rows}, {columns}]"));
        }
        dense[i * columns + j] += value;
    }
    Ok(Array::new(&[rows, columns], dense))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::body::import::pickle::parse;

    /// As Python 2 wrote the official models: protocol 2, byte strings, a `chumpy.ch.Ch` and SciPy matrices.
    const PYTHON_2: &[u8] = include_bytes!("fixtures/python2.pkl");
    /// The same dictionary by Python 2's protocol 0.
    const PROTOCOL_0: &[u8] = include_bytes!("fixtures/protocol0.pkl");
    /// The same with plain arrays by Python 3, protocol 4 and protocol 2.
    const PYTHON_3: [&[u8]; 2] =
        [include_bytes!("fixtures/python3.pkl"), include_bytes!("fixtures/python3_protocol2.pkl")];

    /// Tables of names as SMPL-X's pickles hold them (object arrays without a shape), texts, a matrix as lists, and chumpy
    /// objects; by Python 3, protocol 2.
    const OBJECTS: &[u8] = include_bytes!("fixtures/objects.pkl");

    const NAMES: [&str; 10] =
        ["v_template", "shapedirs", "f", "kintree_table", "bs_style", "J_regressor", "fortran", "big", "csr", "coo"];

    fn read(bytes: &[u8]) -> Npz {
        dictionary(&parse(bytes).unwrap().value, &NAMES, 1_000).unwrap()
    }

    #[test]
    fn python_2_models_come_out_as_arrays() {
        for bytes in [PYTHON_2, PROTOCOL_0] {
            let npz = read(bytes);
            assert_eq!(*npz.get("v_template").unwrap(), Array::new(&[2, 3], vec![0.5, 1.0, 1.5, 2.0, 2.5, -3.0]));
            assert_eq!(*npz.get("shapedirs").unwrap(), Array::new(&[1, 3, 2], vec![0., 1., 2., 3., 4., 5.]));
            assert_eq!(*npz.get("f").unwrap(), Array::new(&[1, 3], vec![0.0, 1.0, 70_000.0]));
            let kintree = [4_294_967_295.0, 0.0, 0.0, 1.0];
            assert_eq!(*npz.get("kintree_table").unwrap(), Array::new(&[2, 2], kintree.into()));
            assert_eq!(npz.skipped["bs_style"], "3 bytes, expected numbers");
        }
    }

    #[test]
    fn fortran_order_and_big_endian_are_turned() {
        assert_eq!(*read(PYTHON_2).get("fortran").unwrap(), Array::new(&[2, 3], vec![1., 2., 3., 4., 5., 6.]));
        assert_eq!(*read(PYTHON_2).get("big").unwrap(), Array::new(&[2], vec![1.0, 258.0]));
    }

    #[test]
    fn sparse_matrices_become_dense() {
        let expected = Array::new(&[2, 3], vec![0.0, 0.25, 0.0, 1.0, 0.0, 0.75]);
        for name in ["J_regressor", "csr", "coo"] {
            assert_eq!(*read(PYTHON_2).get(name).unwrap(), expected, "{name}");
        }
    }

    #[test]
    fn python_3_arrays_come_out_too() {
        for bytes in PYTHON_3 {
            let npz = read(bytes);
            assert_eq!(*npz.get("v_template").unwrap(), Array::new(&[2, 3], vec![0.5, 1.0, 1.5, 2.0, 2.5, -3.0]));
        }
    }

    #[test]
    fn what_is_no_array_of_numbers_keeps_nothing_else_from_being_read() {
        let names = ["joint2num", "part2num", "names", "lil", "posedirs", "bs_style", "v_template"];
        let npz = dictionary(&parse(OBJECTS).unwrap().value, &names, 1_000).unwrap();
        assert_eq!(*npz.get("v_template").unwrap(), Array::new(&[2, 3], vec![0.5, 1.0, 1.5, 2.0, 2.5, -3.0]));
        let reason = |name: &str| npz.skipped[name].as_str();
        assert_eq!(
            [reason("joint2num"), reason("part2num"), reason("names")],
            ["type O8, expected numbers", "type O8, expected numbers", "type U2, expected numbers"]
        );
        assert_eq!(reason("lil"), "type O8, expected numbers");
        assert_eq!(reason("posedirs"), "an object of chumpy.reordering.transpose without `x`, expected numbers");
        assert_eq!(reason("bs_style"), "a text of 3 bytes, expected numbers");
    }

    #[test]
    fn a_slice_by_chumpy_is_taken() {
        let npz = dictionary(&parse(OBJECTS).unwrap().value, &["shapedirs", "far"], 1_000).unwrap();
        // The first two of four components of two vertices.
        let expected = [0., 1., 4., 5., 8., 9., 12., 13., 16., 17., 20., 21.];
        assert_eq!(*npz.get("shapedirs").unwrap(), Array::new(&[2, 3, 2], expected.into()));
        assert_eq!(npz.skipped["far"], "a selection of values that are not among the 2");
    }

    #[test]
    fn only_what_is_asked_for_is_decoded_and_its_values_are_limited_together() {
        let pickle = parse(PYTHON_2).unwrap();
        let read = |names: &[&str], max_values| dictionary(&pickle.value, names, max_values).unwrap();
        // Six values each.
        let npz = read(&["v_template", "fortran"], 11);
        assert!(npz.arrays.keys().eq(["v_template"]));
        assert_eq!(npz.skipped["fortran"], "shape [2, 3] is too large");
        let npz = read(&["v_template", "fortran"], 12);
        assert!(npz.arrays.keys().eq(["fortran", "v_template"]) && npz.skipped.is_empty());
        assert!(read(&["fortran"], 6).skipped.is_empty());
    }

    #[test]
    fn a_matrix_whose_lines_overlap_is_refused_before_they_are_followed() {
        // {'shape': (4, 2)}
        let state = parse(b"}U\x05shape(K\x04K\x02ts.").unwrap();
        let of_starts = |starts: &[f64]| {
            let field = |name: &str| {
                let data = if name == "indptr" { starts } else { &[1.0, 1.0] };
                Ok(Array::new(&[data.len()], data.to_vec()))
            };
            sparse("scipy.sparse.csr.csr_matrix", &state.value, 100, field)
        };
        assert!(of_starts(&[0.0, 0.0, 1.0, 2.0, 2.0]).is_ok());
        assert_eq!(of_starts(&[0.0, 2.0, 0.0, 2.0, 2.0]).unwrap_err(), "a sparse matrix whose lines overlap");
    }
}
