//! LPIPS (Zhang et al. 2018) by a network that the user gives, as ONNX: two pictures in, a distance out. The network is not part
//! of the program, and builds without the feature `lpips` cannot run one.

use std::path::Path;

use image::RgbImage;

/// Why there is no distance.
#[derive(Debug, thiserror::Error)]
pub enum LpipsError {
    #[error("{0}: this program was built without networks; build it with `--features lpips`")]
    NotBuilt(String),
    #[error("{path}: {reason}")]
    Load { path: String, reason: String },
    #[error("the network has {inputs} inputs and {outputs} outputs, expected two pictures in and one distance out")]
    Signature { inputs: usize, outputs: usize },
    #[error("the network failed: {0}")]
    Run(String),
}

/// A network with two inputs `[1, 3, height, width]`, sRGB in [−1, 1], and one number out.
pub struct Lpips {
    #[cfg(feature = "lpips")]
    model: rten::Model,
    #[cfg(not(feature = "lpips"))]
    never: std::convert::Infallible,
}

#[cfg(feature = "lpips")]
impl Lpips {
    pub fn load(path: &Path) -> Result<Self, LpipsError> {
        let named = path.display().to_string();
        let model =
            rten::Model::load_file(path).map_err(|e| LpipsError::Load { path: named, reason: e.to_string() })?;
        let (inputs, outputs) = (model.input_ids().len(), model.output_ids().len());
        if (inputs, outputs) != (2, 1) {
            return Err(LpipsError::Signature { inputs, outputs });
        }
        Ok(Self { model })
    }

    /// The network's distance of two pictures of one size.
    ///
    /// # Panics
    /// When the sizes differ.
    pub fn distance(&self, a: &RgbImage, b: &RgbImage) -> Result<f64, LpipsError> {
        assert_eq!(a.dimensions(), b.dimensions(), "sizes");
        let failed = |e: &dyn std::fmt::Display| LpipsError::Run(e.to_string());
        let mut inputs = Vec::with_capacity(2);
        for (id, picture) in self.model.input_ids().iter().zip([a, b]) {
            let shape = [1, 3, picture.height() as usize, picture.width() as usize];
            let value = rten::Value::from_shape(shape, planes(picture)).map_err(|e| failed(&e))?;
            inputs.push((*id, value.into()));
        }
        let outputs = self.model.run(inputs, self.model.output_ids(), None).map_err(|e| failed(&e))?;
        let distance = outputs.first().map(|value| f32::try_from(value.as_view()));
        match distance {
            Some(Ok(distance)) => Ok(f64::from(distance)),
            Some(Err(e)) => Err(failed(&e)),
            None => Err(failed(&"it gave nothing")),
        }
    }
}

#[cfg(not(feature = "lpips"))]
impl Lpips {
    pub fn load(path: &Path) -> Result<Self, LpipsError> {
        Err(LpipsError::NotBuilt(path.display().to_string()))
    }

    /// Never called: there is no network.
    pub fn distance(&self, _a: &RgbImage, _b: &RgbImage) -> Result<f64, LpipsError> {
        match self.never {}
    }
}

/// `[3, height, width]` in [−1, 1].
#[cfg(feature = "lpips")]
fn planes(picture: &RgbImage) -> Vec<f32> {
    let plane = |k: usize| picture.pixels().map(move |p| f32::from(p.0[k]) / 127.5 - 1.0);
    (0..3).flat_map(plane).collect()
}

#[cfg(test)]
mod tests {
    #[cfg(not(feature = "lpips"))]
    #[test]
    fn a_build_without_networks_says_so() {
        let error = super::Lpips::load(std::path::Path::new("net.onnx")).err().map(|e| e.to_string());
        assert!(error.is_some_and(|e| e.contains("net.onnx") && e.contains("--features lpips")));
    }

    #[cfg(feature = "lpips")]
    mod network {
        use image::{Rgb, RgbImage};

        use super::super::*;

        fn varint(mut n: usize, out: &mut Vec<u8>) {
            while n >= 128 {
                out.push(n as u8 | 128);
                n >>= 7;
            }
            out.push(n as u8);
        }

        /// A field of a protocol buffer that holds a number, and one that holds bytes.
        fn number(field: usize, n: usize) -> Vec<u8> {
            let mut out = Vec::new();
            varint(field << 3, &mut out);
            varint(n, &mut out);
            out
        }

        fn bytes(field: usize, content: &[u8]) -> Vec<u8> {
            let mut out = Vec::new();
            varint(field << 3 | 2, &mut out);
            varint(content.len(), &mut out);
            out.extend(content);
            out
        }

        fn node(operator: &str, inputs: &[&str], output: &str) -> Vec<u8> {
            let inputs = inputs.iter().flat_map(|name| bytes(1, name.as_bytes()));
            let rest = [bytes(2, output.as_bytes()), bytes(4, operator.as_bytes())].concat();
            bytes(1, &inputs.chain(rest).collect::<Vec<u8>>())
        }

        /// An input (field 11) or output (12) of a graph, of floats.
        fn value(field: usize, name: &str) -> Vec<u8> {
            bytes(field, &[bytes(1, name.as_bytes()), bytes(2, &bytes(1, &number(1, 1)))].concat())
        }

        /// An ONNX network of operator set 13 with these inputs: the mean of |a − b|.
        fn network(inputs: &[&str]) -> tempfile::TempPath {
            let nodes = [node("Sub", &["a", "b"], "d"), node("Abs", &["d"], "e"), node("ReduceMean", &["e"], "m")];
            let ports = inputs.iter().flat_map(|name| value(11, name)).chain(value(12, "m"));
            let graph: Vec<u8> = nodes.concat().into_iter().chain(bytes(2, b"g")).chain(ports).collect();
            let model = [number(1, 8), bytes(7, &graph), bytes(8, &number(2, 13))].concat();
            let file = tempfile::Builder::new().suffix(".onnx").tempfile().unwrap();
            std::fs::write(file.path(), model).unwrap();
            file.into_temp_path()
        }

        #[test]
        fn a_given_network_measures_pictures() {
            let lpips = Lpips::load(&network(&["a", "b"])).unwrap();
            let picture = |rgb| RgbImage::from_pixel(12, 9, Rgb(rgb));
            let distance = lpips.distance(&picture([0, 255, 51]), &picture([255, 255, 0])).unwrap();
            // Channels differ by 2, 0 and 0.4 in [−1, 1].
            assert!((distance - 0.8).abs() < 1e-6, "{distance}");
            assert_eq!(lpips.distance(&picture([7; 3]), &picture([7; 3])).unwrap(), 0.0);
        }

        #[test]
        fn what_is_no_such_network_is_refused() {
            let error = |path: &Path| Lpips::load(path).err().map(|e| e.to_string()).unwrap_or_default();
            assert!(error(&network(&["a", "b", "c"])).contains("3 inputs"));
            let text = tempfile::Builder::new().suffix(".onnx").tempfile().unwrap();
            std::fs::write(text.path(), "no network").unwrap();
            assert!(!error(text.path()).is_empty());
        }
    }
}
