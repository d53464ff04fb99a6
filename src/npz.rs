//! NumPy `.npz` archives: numeric arrays by name, read with limits and written in C order.

use std::collections::BTreeMap;
use std::io::{Cursor, Read, Seek, Write};

use npyz::{DType, NpyFile, Order, TypeChar, WriterBuilder};

/// Why an archive could not be read.
#[derive(Debug, thiserror::Error)]
pub enum NpzError {
    #[error("not an npz archive: {0}")]
    Archive(#[from] zip::result::ZipError),
    #[error("array `{array}`: {reason}")]
    Array { array: String, reason: String },
    #[error("array `{0}` is missing")]
    Missing(String),
    #[error(transparent)]
    Io(#[from] std::io::Error),
}

/// A numeric array in C order, whatever it was stored as.
#[derive(Clone, Debug, PartialEq)]
pub struct Array {
    pub shape: Vec<usize>,
    pub data: Vec<f64>,
}

impl Array {
    pub fn new(shape: &[usize], data: Vec<f64>) -> Self {
        assert_eq!(shape.iter().product::<usize>(), data.len(), "shape {shape:?} does not fit the data");
        Self { shape: shape.to_vec(), data }
    }

    /// An array whose data has the first axis running fastest.
    pub fn from_fortran(shape: &[usize], data: &[f64]) -> Self {
        Self::new(shape, to_c_order(shape, data))
    }

    pub fn f32(&self) -> Vec<f32> {
        self.data.iter().map(|&x| x as f32).collect()
    }

    /// The values as indices. NaN and negative values become 0 and saturate at the top, as Rust's casts do.
    pub fn usize(&self) -> Vec<usize> {
        self.data.iter().map(|&x| x as usize).collect()
    }
}

/// The arrays of an archive. Entries that are not numeric arrays (strings, objects) are kept as names with reasons.
#[derive(Clone, Debug, Default)]
pub struct Npz {
    pub arrays: BTreeMap<String, Array>,
    pub skipped: BTreeMap<String, String>,
}

impl Npz {
    /// Reads an archive whose arrays hold at most `max_values` values together; nothing bigger is allocated.
    pub fn read(reader: impl Read + Seek, max_values: usize) -> Result<Self, NpzError> {
        let mut archive = zip::ZipArchive::new(reader)?;
        let mut npz = Npz::default();
        let mut left = max_values;
        for i in 0..archive.len() {
            let entry = archive.by_index(i)?;
            let Some(name) = entry.name()?.strip_suffix(".npy").map(str::to_owned) else { continue };
            // A value takes at most 8 bytes; the header is small.
            let mut bytes = Vec::new();
            entry.take(left as u64 * 8 + 65_536).read_to_end(&mut bytes)?;
            match parse_npy(&bytes, left) {
                Ok(Some(array)) => {
                    left -= array.data.len();
                    npz.arrays.insert(name, array);
                }
                Ok(None) => {
                    npz.skipped.insert(name, "no array of float32, float64 or integers".to_owned());
                }
                Err(reason) => return Err(NpzError::Array { array: name, reason }),
            }
        }
        Ok(npz)
    }

    pub fn open(path: &std::path::Path) -> Result<Self, NpzError> {
        Self::read(std::io::BufReader::new(std::fs::File::open(path)?), 1 << 30)
    }

    pub fn get(&self, name: &str) -> Result<&Array, NpzError> {
        self.arrays.get(name).ok_or_else(|| NpzError::Missing(name.to_owned()))
    }

    /// The array when it has this shape; `usize::MAX` stands for any length.
    pub fn shaped(&self, name: &str, shape: &[usize]) -> Result<&Array, NpzError> {
        let array = self.get(name)?;
        let fits = array.shape.len() == shape.len()
            && array.shape.iter().zip(shape).all(|(have, want)| *want == usize::MAX || have == want);
        if fits {
            return Ok(array);
        }
        let want: Vec<String> =
            shape.iter().map(|&n| if n == usize::MAX { "any".to_owned() } else { n.to_string() }).collect();
        let reason = format!("shape {:?}, expected [{}]", array.shape, want.join(", "));
        Err(NpzError::Array { array: name.to_owned(), reason })
    }

    /// The single value of an array with one element.
    pub fn scalar(&self, name: &str) -> Result<f64, NpzError> {
        let array = self.get(name)?;
        match array.data[..] {
            [value] => Ok(value),
            _ => Err(NpzError::Array { array: name.to_owned(), reason: "expected one value".to_owned() }),
        }
    }
}

/// Parses one `.npy` file; `None` for a type that is not numeric.
pub fn parse_npy(bytes: &[u8], max_values: usize) -> Result<Option<Array>, String> {
    check_sizes(bytes)?;
    let file = NpyFile::new(Cursor::new(bytes)).map_err(|e| e.to_string())?;
    let shape = file.shape().iter().map(|&n| usize::try_from(n)).collect::<Result<Vec<_>, _>>();
    let shape = shape.map_err(|e| e.to_string())?;
    let count = shape.iter().try_fold(1usize, |a, &n| a.checked_mul(n)).filter(|&n| n <= max_values);
    let count = count.ok_or_else(|| format!("shape {shape:?} is too large"))?;
    let DType::Plain(kind) = file.dtype() else { return Ok(None) };
    let size = kind.size_field() as usize;
    if count.checked_mul(size).is_none_or(|n| n > bytes.len()) {
        return Err(format!("shape {shape:?} needs more data than the file has"));
    }
    let order = file.order();
    macro_rules! values {
        ($t:ty) => {
            file.into_vec::<$t>().map_err(|e| e.to_string())?.into_iter().map(|x| x as f64).collect::<Vec<f64>>()
        };
    }
    let data = match (kind.type_char(), size) {
        (TypeChar::Float, 4) => values!(f32),
        (TypeChar::Float, 8) => values!(f64),
        (TypeChar::Int, 1) => values!(i8),
        (TypeChar::Int, 2) => values!(i16),
        (TypeChar::Int, 4) => values!(i32),
        (TypeChar::Int, 8) => values!(i64),
        (TypeChar::Uint, 1) => values!(u8),
        (TypeChar::Uint, 2) => values!(u16),
        (TypeChar::Uint, 4) => values!(u32),
        (TypeChar::Uint, 8) => values!(u64),
        (TypeChar::Bool, _) => {
            file.into_vec::<bool>().map_err(|e| e.to_string())?.into_iter().map(|x| x as u8 as f64).collect()
        }
        _ => return Ok(None),
    };
    let data = if order == Order::Fortran { to_c_order(&shape, &data) } else { data };
    Ok(Some(Array { shape, data }))
}

/// The reader multiplies the numbers of a header's tuples without a look at how large they get.
fn check_sizes(bytes: &[u8]) -> Result<(), String> {
    let header = bytes.split(|&byte| byte == b'\n').next().unwrap_or_default();
    let text = String::from_utf8_lossy(header);
    for tuple in text.split('(').skip(1).filter_map(|rest| rest.split(')').next()) {
        let numbers = tuple.split(|c: char| !c.is_ascii_digit()).filter(|digits| !digits.is_empty());
        let product = numbers.map(str::parse::<u64>).try_fold(1u64, |a, n| a.checked_mul(n.ok()?.max(1)));
        product.ok_or_else(|| format!("shape ({tuple}) is too large"))?;
    }
    Ok(())
}

fn to_c_order(shape: &[usize], data: &[f64]) -> Vec<f64> {
    let mut index = vec![0; shape.len()];
    let mut out = Vec::with_capacity(data.len());
    for _ in 0..data.len() {
        let (mut at, mut stride) = (0, 1);
        for (i, n) in index.iter().zip(shape) {
            at += i * stride;
            stride *= n;
        }
        out.push(data[at]);
        for axis in (0..shape.len()).rev() {
            index[axis] += 1;
            if index[axis] < shape[axis] {
                break;
            }
            index[axis] = 0;
        }
    }
    out
}

/// Writes an archive, one array after another.
pub struct NpzWriter<W: Write + Seek> {
    zip: zip::ZipWriter<W>,
    method: zip::CompressionMethod,
}

impl<W: Write + Seek> NpzWriter<W> {
    pub fn new(writer: W) -> Self {
        Self { zip: zip::ZipWriter::new(writer), method: zip::CompressionMethod::Deflated }
    }

    /// Without compression, for files that are written often and read seldom: floats shrink by a tenth.
    pub fn stored(writer: W) -> Self {
        Self { method: zip::CompressionMethod::Stored, ..Self::new(writer) }
    }

    /// Adds an array of any NumPy type that Rust has (`f32`, `f64`, `u32`, `i64`, …).
    pub fn add<T: npyz::AutoSerialize + Copy>(
        &mut self,
        name: &str,
        shape: &[usize],
        data: &[T],
    ) -> Result<(), NpzError> {
        assert_eq!(shape.iter().product::<usize>(), data.len(), "{name}: shape {shape:?} does not fit the data");
        let options = zip::write::SimpleFileOptions::default().last_modified_time(zip::DateTime::default());
        let options = options.compression_method(self.method);
        self.zip.start_file(format!("{name}.npy"), options)?;
        let mut bytes = Vec::new();
        {
            let shape: Vec<u64> = shape.iter().map(|&n| n as u64).collect();
            let mut writer = npyz::WriteOptions::new().default_dtype().shape(&shape).writer(&mut bytes).begin_nd()?;
            writer.extend(data.iter().copied())?;
            writer.finish()?;
        }
        self.zip.write_all(&bytes)?;
        Ok(())
    }

    pub fn finish(self) -> Result<W, NpzError> {
        Ok(self.zip.finish()?)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn arrays_come_back_as_they_went_in() {
        let mut writer = NpzWriter::new(Cursor::new(Vec::new()));
        writer.add("a", &[2, 3], &[1.0f32, 2.0, 3.0, 4.0, 5.0, 6.0]).unwrap();
        writer.add("n", &[], &[7i64]).unwrap();
        let npz = Npz::read(writer.finish().unwrap(), 100).unwrap();
        assert_eq!(*npz.shaped("a", &[usize::MAX, 3]).unwrap(), Array::new(&[2, 3], vec![1., 2., 3., 4., 5., 6.]));
        assert_eq!(npz.scalar("n").unwrap(), 7.0);
        let error = npz.shaped("a", &[3, usize::MAX]).unwrap_err().to_string();
        assert_eq!(error, "array `a`: shape [2, 3], expected [3, any]");
    }

    #[test]
    fn a_shape_larger_than_the_limit_is_refused_before_it_is_allocated() {
        let mut writer = NpzWriter::new(Cursor::new(Vec::new()));
        writer.add("a", &[1000], &[0.0f64; 1000]).unwrap();
        let bytes = writer.finish().unwrap();
        assert!(Npz::read(bytes, 999).unwrap_err().to_string().contains("too large"));
    }

    #[test]
    fn fortran_order_is_turned() {
        assert_eq!(to_c_order(&[2, 3], &[1., 4., 2., 5., 3., 6.]), [1., 2., 3., 4., 5., 6.]);
    }
}
