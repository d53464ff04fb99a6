//! Meshes as binary little-endian PLY: written for users, read back for evaluation.

use std::io::{BufRead, Read, Write};

/// A triangle mesh in metres; `colours` (sRGB) is empty or one a vertex.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Mesh {
    /// `[V, 3]`
    pub vertices: Vec<[f32; 3]>,
    /// `[F, 3]`
    pub faces: Vec<[u32; 3]>,
    /// `[V, 3]` or empty
    pub colours: Vec<[u8; 3]>,
}

impl Mesh {
    /// The same surface without the vertices that no face has.
    pub fn without_loose_vertices(&self) -> Mesh {
        let mut used = vec![false; self.vertices.len()];
        self.faces.as_flattened().iter().for_each(|&v| used[v as usize] = true);
        let mut mesh = Mesh::default();
        let mut place = vec![0; used.len()];
        for v in (0..used.len()).filter(|&v| used[v]) {
            place[v] = mesh.vertices.len() as u32;
            mesh.vertices.push(self.vertices[v]);
            mesh.colours.extend(self.colours.get(v));
        }
        mesh.faces = self.faces.iter().map(|face| face.map(|v| place[v as usize])).collect();
        mesh
    }
}

/// Why a PLY file could not be read.
#[derive(Debug, thiserror::Error)]
pub enum PlyError {
    #[error("not a PLY file that is understood: {0}")]
    Format(String),
    #[error(transparent)]
    Io(#[from] std::io::Error),
}

/// Writes `mesh`: float x y z, uchar red green blue where it has colours, faces as `list uchar int vertex_indices`.
pub fn write(mesh: &Mesh, mut out: impl Write) -> std::io::Result<()> {
    let coloured = !mesh.colours.is_empty();
    let mut bytes = Vec::with_capacity(256 + mesh.vertices.len() * 15 + mesh.faces.len() * 13);
    writeln!(bytes, "ply\nformat binary_little_endian 1.0\ncomment metres")?;
    writeln!(bytes, "element vertex {}", mesh.vertices.len())?;
    bytes.extend(b"property float x\nproperty float y\nproperty float z\n");
    if coloured {
        bytes.extend(b"property uchar red\nproperty uchar green\nproperty uchar blue\n");
    }
    writeln!(bytes, "element face {}", mesh.faces.len())?;
    bytes.extend(b"property list uchar int vertex_indices\nend_header\n");
    for (i, vertex) in mesh.vertices.iter().enumerate() {
        bytes.extend(vertex.iter().flat_map(|x| x.to_le_bytes()));
        if coloured {
            bytes.extend(mesh.colours[i]);
        }
    }
    for face in &mesh.faces {
        bytes.push(3);
        bytes.extend(face.iter().flat_map(|&i| (i as i32).to_le_bytes()));
    }
    out.write_all(&bytes)
}

/// A scalar type of the format: bytes and how to read them.
#[derive(Clone, Copy, PartialEq)]
enum Scalar {
    I8,
    U8,
    I16,
    U16,
    I32,
    U32,
    F32,
    F64,
}

impl Scalar {
    fn parse(name: &str) -> Result<Self, PlyError> {
        Ok(match name {
            "char" | "int8" => Self::I8,
            "uchar" | "uint8" => Self::U8,
            "short" | "int16" => Self::I16,
            "ushort" | "uint16" => Self::U16,
            "int" | "int32" => Self::I32,
            "uint" | "uint32" => Self::U32,
            "float" | "float32" => Self::F32,
            "double" | "float64" => Self::F64,
            _ => return Err(PlyError::Format(format!("type `{name}`"))),
        })
    }

    fn read(self, input: &mut impl Read) -> Result<f64, PlyError> {
        fn bytes<const N: usize>(input: &mut impl Read) -> Result<[u8; N], PlyError> {
            let mut buffer = [0; N];
            input.read_exact(&mut buffer)?;
            Ok(buffer)
        }
        Ok(match self {
            Self::I8 => i8::from_le_bytes(bytes(input)?) as f64,
            Self::U8 => u8::from_le_bytes(bytes(input)?) as f64,
            Self::I16 => i16::from_le_bytes(bytes(input)?) as f64,
            Self::U16 => u16::from_le_bytes(bytes(input)?) as f64,
            Self::I32 => i32::from_le_bytes(bytes(input)?) as f64,
            Self::U32 => u32::from_le_bytes(bytes(input)?) as f64,
            Self::F32 => f32::from_le_bytes(bytes(input)?) as f64,
            Self::F64 => f64::from_le_bytes(bytes(input)?),
        })
    }
}

enum Property {
    Scalar(String, Scalar),
    List(Scalar, Scalar),
}

struct Element {
    name: String,
    count: usize,
    properties: Vec<Property>,
}

fn header(input: &mut impl BufRead) -> Result<Vec<Element>, PlyError> {
    let mut elements: Vec<Element> = Vec::new();
    let mut line = String::new();
    for number in 0.. {
        line.clear();
        if input.by_ref().take(4096).read_line(&mut line)? == 0 {
            return Err(PlyError::Format("the header has no end".to_owned()));
        }
        let words: Vec<&str> = line.split_whitespace().collect();
        match (number, words.as_slice()) {
            (0, ["ply"]) => {}
            (0, _) => return Err(PlyError::Format("it does not begin with `ply`".to_owned())),
            (_, ["format", "binary_little_endian", _] | ["comment" | "obj_info", ..] | []) => {}
            (_, ["format", other, _]) => return Err(PlyError::Format(format!("format {other}"))),
            (_, ["element", name, count]) => {
                let count = count.parse().map_err(|_| PlyError::Format(format!("element count {count}")))?;
                elements.push(Element { name: (*name).to_owned(), count, properties: Vec::new() });
            }
            (_, ["property", rest @ ..]) => {
                let property = match rest {
                    ["list", count, item, _] => Property::List(Scalar::parse(count)?, Scalar::parse(item)?),
                    [kind, name] => Property::Scalar((*name).to_owned(), Scalar::parse(kind)?),
                    _ => return Err(PlyError::Format(line.trim().to_owned())),
                };
                let element = elements.last_mut();
                element
                    .ok_or_else(|| PlyError::Format("property before element".to_owned()))?
                    .properties
                    .push(property);
            }
            (_, ["end_header"]) => return Ok(elements),
            _ => return Err(PlyError::Format(line.trim().to_owned())),
        }
    }
    unreachable!("the loop only ends by returning")
}

/// What the scalars of one row of an element say, as far as a vertex has them.
#[derive(Default)]
struct Row {
    point: [f32; 3],
    colour: [u8; 3],
    has_colour: bool,
}

impl Row {
    /// Reads the next row; lists of a face go to `faces`, as fans.
    fn read(element: &Element, input: &mut impl Read, faces: &mut Vec<[u32; 3]>) -> Result<Self, PlyError> {
        let mut row = Row::default();
        for property in &element.properties {
            match property {
                Property::Scalar(name, kind) => row.set(name, kind.read(input)?),
                Property::List(count, item) => {
                    let n = count.read(input)? as usize;
                    let corners = (0..n).map(|_| Ok(item.read(input)? as u32));
                    let corners = corners.collect::<Result<Vec<u32>, PlyError>>()?;
                    if element.name == "face" {
                        faces.extend((2..n).map(|k| [corners[0], corners[k - 1], corners[k]]));
                    }
                }
            }
        }
        Ok(row)
    }

    fn set(&mut self, name: &str, value: f64) {
        match name {
            "x" => self.point[0] = value as f32,
            "y" => self.point[1] = value as f32,
            "z" => self.point[2] = value as f32,
            "red" => (self.colour[0], self.has_colour) = (value as u8, true),
            "green" => self.colour[1] = value as u8,
            "blue" => self.colour[2] = value as u8,
            _ => {}
        }
    }
}

/// Reads a binary little-endian PLY of triangles (larger polygons become fans) with any scalar types.
pub fn read(mut input: impl BufRead) -> Result<Mesh, PlyError> {
    let mut mesh = Mesh::default();
    for element in header(&mut input)? {
        for _ in 0..element.count {
            let row = Row::read(&element, &mut input, &mut mesh.faces)?;
            if element.name == "vertex" {
                mesh.vertices.push(row.point);
                mesh.colours.extend(row.has_colour.then_some(row.colour));
            }
        }
    }
    let n = mesh.vertices.len() as u32;
    match mesh.faces.iter().flatten().find(|&&i| i >= n) {
        Some(i) => Err(PlyError::Format(format!("a face names vertex {i} of {n}"))),
        None => Ok(mesh),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn triangle() -> Mesh {
        Mesh {
            vertices: vec![[0.0, 0.5, -1.25], [1.0, 0.0, 0.0], [0.0, 1.0, 2.0]],
            faces: vec![[0, 1, 2], [2, 1, 0]],
            colours: vec![[255, 0, 1], [2, 3, 4], [5, 6, 7]],
        }
    }

    #[test]
    fn a_mesh_comes_back_with_and_without_colours() {
        for colours in [triangle().colours, Vec::new()] {
            let mesh = Mesh { colours, ..triangle() };
            let mut bytes = Vec::new();
            write(&mesh, &mut bytes).unwrap();
            assert_eq!(read(bytes.as_slice()).unwrap(), mesh);
        }
    }

    #[test]
    fn loose_vertices_go_and_the_surface_stays() {
        let whole = triangle();
        assert_eq!(whole.without_loose_vertices(), whole);
        let mut loose = whole.clone();
        loose.vertices.insert(1, [9.0; 3]);
        loose.colours.insert(1, [9; 3]);
        loose.faces = vec![[0, 2, 3], [3, 2, 0]];
        assert_eq!(loose.without_loose_vertices(), whole);
        loose.colours.clear();
        assert_eq!(loose.without_loose_vertices(), Mesh { colours: Vec::new(), ..whole });
    }

    #[test]
    fn the_bytes_are_those_of_the_format() {
        let mut bytes = Vec::new();
        write(&triangle(), &mut bytes).unwrap();
        let end = bytes.windows(11).position(|w| w == b"end_header\n").unwrap() + 11;
        let head = std::str::from_utf8(&bytes[..end]).unwrap();
        assert!(head.contains("property list uchar int vertex_indices"), "{head}");
        assert_eq!(bytes.len() - end, 3 * 15 + 2 * 13);
        assert_eq!(bytes[end + 8..end + 12], (-1.25f32).to_le_bytes());
        assert_eq!(bytes[end + 12..end + 15], [255, 0, 1]);
        assert_eq!(bytes[end + 45..end + 50], [3, 0, 0, 0, 0]);
    }

    #[test]
    fn sixteen_bit_indices_and_quads_are_read() {
        let mut bytes =
            b"ply\nformat binary_little_endian 1.0\nelement vertex 4\nproperty double x\nproperty double y\n\
            property double z\nelement face 1\nproperty list uchar ushort vertex_indices\nend_header\n"
                .to_vec();
        bytes.extend((0..12).flat_map(|i| (i as f64).to_le_bytes()));
        bytes.push(4);
        bytes.extend((0..4u16).flat_map(|i| i.to_le_bytes()));
        let mesh = read(bytes.as_slice()).unwrap();
        assert_eq!(mesh.faces, [[0, 1, 2], [0, 2, 3]]);
        assert_eq!(mesh.vertices[3], [9.0, 10.0, 11.0]);
    }

    #[test]
    fn what_is_no_ply_is_refused_with_the_reason() {
        let mut bytes = Vec::new();
        let mesh = Mesh { faces: vec![[0, 1, 3]], ..triangle() };
        write(&mesh, &mut bytes).unwrap();
        assert!(read(bytes.as_slice()).unwrap_err().to_string().contains("vertex 3 of 3"));
        assert!(read(&bytes[..bytes.len() - 1]).is_err());
        assert!(read(&b"obj\n"[..]).unwrap_err().to_string().contains("begin with"));
        assert!(read(&b"ply\nformat ascii 1.0\n"[..]).unwrap_err().to_string().contains("ascii"));
    }
}
