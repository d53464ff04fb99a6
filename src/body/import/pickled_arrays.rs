//! Arrays in pickles: NumPy's, and those inside chumpy's and SciPy's sparse objects.

use super::pickle::{Object, Value};
use crate::npz::{Array, Npz};

/// Larger arrays do not occur in body models.
const MAX_VALUES: usize = 1 << 28;

/// The numeric arrays of a pickled dictionary. What is no array (strings, settings) is kept as a name only.
pub fn dictionary(value: &Value) -> Result<Npz, String> {
    let entries = match value {
        Value::Dict(entries) => entries.clone(),
        Value::Object(object) => match &object.borrow().state {
            Value::Dict(entries) => entries.clone(),
            _ => return Err("not a dictionary".to_owned()),
        },
        _ => return Err("not a dictionary".to_owned()),
    };
    let mut npz = Npz::default();
    for (key, value) in entries.borrow().iter() {
        let Some(key) = key.string() else { continue };
        match array(value, 0) {
            Ok(Some(array)) => _ = npz.arrays.insert(key, array),
            Ok(None) => npz.skipped.push(key),
            Err(reason) => return Err(format!("`{key}`: {reason}")),
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

fn array(value: &Value, depth: usize) -> Result<Option<Array>, String> {
    if depth > MAX_DEPTH {
        return Err("objects within objects without an end".to_owned());
    }
    let Value::Object(object) = value else { return Ok(numbers(value)) };
    let object = object.borrow();
    let class = class(&object);
    if class.ends_with("multiarray._reconstruct") {
        return numpy(&object.state).map(Some);
    }
    if class.ends_with("numeric._frombuffer") {
        let args = object.args.items().unwrap_or_default();
        let [data, dtype, shape, order] = &args[..] else { return Err("a buffer without a shape".to_owned()) };
        let fortran = order.string().as_deref() == Some("F");
        return decode(data, dtype, shape, fortran).map(Some);
    }
    let field = |name: &str| object.state.get(name).map(|v| array(&v, depth + 1)).transpose().map(Option::flatten);
    if class.starts_with("scipy.sparse") {
        return sparse(&class, &object.state, field).map(Some);
    }
    // chumpy keeps the numbers of a constant in `x`.
    field("x")
}

/// A list of numbers.
fn numbers(value: &Value) -> Option<Array> {
    let number = |value: &Value| match value {
        Value::Float(number) => Some(*number),
        other => other.int().map(|number| number as f64),
    };
    let data: Vec<f64> = value.items()?.iter().map(number).collect::<Option<_>>()?;
    Some(Array::new(&[data.len()], data))
}

/// `(version, shape, dtype, is Fortran order, data)`
fn numpy(state: &Value) -> Result<Array, String> {
    let state = state.items().unwrap_or_default();
    let [_, shape, dtype, fortran, data] = &state[..] else { return Err("a NumPy array without data".to_owned()) };
    decode(data, dtype, shape, fortran.int() == Some(1))
}

/// Bytes; or the call that Python 3 writes for them in the old protocols, `_codecs.encode(text, 'latin1')`.
fn bytes(value: &Value) -> Option<Vec<u8>> {
    match value {
        Value::Bytes(bytes) => Some(bytes.to_vec()),
        Value::Object(object) if class(&object.borrow()) == "_codecs.encode" => {
            let text = object.borrow().args.items()?.first()?.string()?;
            text.chars().map(|c| u8::try_from(u32::from(c)).ok()).collect()
        }
        _ => None,
    }
}

fn decode(data: &Value, dtype: &Value, shape: &Value, fortran: bool) -> Result<Array, String> {
    let Value::Object(dtype) = dtype else { return Err("an array without a type".to_owned()) };
    let dtype = dtype.borrow();
    let kind = dtype.args.items().and_then(|args| args.first()?.string()).unwrap_or_default();
    let order = dtype.state.items().and_then(|state| state.get(1)?.string()).unwrap_or_default();
    let big = order == ">" || kind.starts_with('>');
    let kind = kind.trim_start_matches(['<', '>', '|', '=']);

    let shape: Option<Vec<usize>> =
        shape.items().and_then(|shape| shape.iter().map(|n| n.int().and_then(|n| n.try_into().ok())).collect());
    let shape = shape.ok_or("an array without a shape")?;
    let count = shape.iter().try_fold(1usize, |a, &n| a.checked_mul(n)).filter(|&n| n <= MAX_VALUES);
    let count = count.ok_or_else(|| format!("shape {shape:?} is too large"))?;
    let data = bytes(data).ok_or_else(|| format!("type {kind}, expected numbers"))?;

    macro_rules! numbers {
        ($t:ty) => {{
            const SIZE: usize = std::mem::size_of::<$t>();
            let chunks = data.as_chunks::<SIZE>().0.iter();
            chunks.map(|&c| if big { <$t>::from_be_bytes(c) } else { <$t>::from_le_bytes(c) } as f64).collect()
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
    if values.len() != count {
        return Err(format!("{} values, expected {count} for shape {shape:?}", values.len()));
    }
    Ok(if fortran { Array::from_fortran(&shape, &values) } else { Array::new(&shape, values) })
}

/// A SciPy sparse matrix in one of the formats csc, csr and coo, made dense; entries given twice add up.
fn sparse(class: &str, state: &Value, field: impl Fn(&str) -> Result<Option<Array>, String>) -> Result<Array, String> {
    let shape = state.get("_shape").or_else(|| state.get("shape")).and_then(|v| v.items()).unwrap_or_default();
    let [Some(rows), Some(columns)] = [0, 1].map(|i| shape.get(i).and_then(|n| usize::try_from(n.int()?).ok())) else {
        return Err("a sparse matrix without a shape".to_owned());
    };
    let size = rows.checked_mul(columns).filter(|&n| n <= MAX_VALUES);
    let size = size.ok_or_else(|| format!("shape [{rows}, {columns}] is too large"))?;
    let need = |name: &str| field(name)?.ok_or_else(|| format!("a sparse matrix without `{name}`"));
    let data = need("data")?.data;
    let by_column = class.ends_with("csc_matrix") || class.ends_with("csc_array");
    let (i, j) = if class.ends_with("coo_matrix") || class.ends_with("coo_array") {
        (need("row")?.usize(), need("col")?.usize())
    } else if by_column || class.ends_with("csr_matrix") || class.ends_with("csr_array") {
        let starts = need("indptr")?.usize();
        let lines = starts.windows(2).enumerate();
        let major = lines.flat_map(|(line, ends)| (ends[0]..ends[1].min(data.len())).map(move |_| line)).collect();
        let minor = need("indices")?.usize();
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

    fn read(bytes: &[u8]) -> Npz {
        dictionary(&parse(bytes).unwrap().value).unwrap()
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
            assert!(npz.skipped.contains(&"bs_style".to_owned()));
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
}
