//! The base mesh: `3dobjs/base.obj` and the tables beside it, in metres.

use std::collections::HashMap;
use std::ops::Range;

use glam::DVec3;

use super::archive::Wheel;
use crate::body::import::{ImportError, bad, pickle};

/// The files hold decimetres.
pub(super) const METRES: f32 = 0.1;

/// A quad's vertex and texture corner.
pub(super) type Corner = (u32, u32);

#[derive(Default)]
pub(super) struct BaseMesh {
    /// All vertices, with the helpers' and the joint cubes, `[19158]`.
    pub vertices: Vec<[f32; 3]>,
    /// OBJ's convention: v runs up.
    pub uvs: Vec<[f32; 2]>,
    /// The body's quads alone, counter-clockwise from outside.
    pub quads: Vec<[Corner; 4]>,
    /// The vertex on the other side.
    pub mirror: Vec<u32>,
    /// Vertices of the eye sockets and of the mouth's inside, by index.
    pub in_cavity: Vec<bool>,
    /// The 8-vertex cubes round each joint of the original rig.
    pub cubes: HashMap<String, Range<usize>>,
}

fn parse<T: std::str::FromStr>(field: Option<&str>, part: &str, line: &str) -> Result<T, ImportError> {
    field.and_then(|s| s.parse().ok()).ok_or_else(|| bad(part, format!("cannot read the line `{line}`")))
}

impl BaseMesh {
    pub(super) fn read(wheel: &mut Wheel) -> Result<Self, ImportError> {
        let mut mesh = parse_obj(&wheel.text("mpfb2/3dobjs/base.obj")?)?;
        let n = mesh.vertices.len();
        mesh.mirror = parse_mirror(&wheel.text("mpfb2/mesh_metadata/hm08.mirror")?, n)?;
        mesh.cubes = parse_cubes(&wheel.data("mpfb2/mesh_metadata/basemesh_vertex_groups.json")?, n)?;
        for vertex in parse_cavities(wheel.data("template_mesh_internal_cavities.pth")?)? {
            *mesh.in_cavity.get_mut(vertex).ok_or_else(|| bad("internal cavities", "index out of range"))? = true;
        }
        Ok(mesh)
    }

    /// A joint of the original rig: the mean of its cube on these vertices (metres).
    pub(super) fn cube(&self, vertices: &[[f32; 3]], name: &str) -> Result<DVec3, ImportError> {
        let range = self.cubes.get(name).ok_or_else(|| bad(format!("joint-{name}"), "no such cube"))?;
        let sum: DVec3 = vertices[range.clone()].iter().map(|v| DVec3::from(v.map(f64::from))).sum();
        Ok(sum / range.len() as f64)
    }
}

fn parse_obj(text: &str) -> Result<BaseMesh, ImportError> {
    let part = "base.obj";
    let (mut vertices, mut uvs, mut quads, mut group) = (Vec::new(), Vec::new(), Vec::new(), "");
    for line in text.lines() {
        let mut fields = line.split_ascii_whitespace();
        match fields.next() {
            Some("v") => {
                let mut next = || parse::<f32>(fields.next(), part, line);
                vertices.push([next()? * METRES, next()? * METRES, next()? * METRES]);
            }
            Some("vt") => {
                let mut next = || parse::<f32>(fields.next(), part, line);
                uvs.push([next()?, next()?]);
            }
            Some("g") => group = fields.next().unwrap_or(""),
            Some("f") if group == "body" => {
                let mut quad = [(0, 0); 4];
                for corner in &mut quad {
                    let (v, t) = fields.next().and_then(|s| s.split_once('/')).unwrap_or_default();
                    *corner = (parse::<u32>(Some(v), part, line)?, parse::<u32>(Some(t), part, line)?);
                }
                quads.push(quad);
            }
            _ => {}
        }
    }
    // OBJ counts from one.
    for (v, t) in quads.as_flattened_mut() {
        (*v, *t) = (v.wrapping_sub(1), t.wrapping_sub(1));
        if *v as usize >= vertices.len() || *t as usize >= uvs.len() {
            return Err(bad(part, "a face names a vertex that is not there"));
        }
    }
    let in_cavity = vec![false; vertices.len()];
    Ok(BaseMesh { vertices, uvs, quads, in_cavity, ..BaseMesh::default() })
}

/// Lines `vertex mirrored side`.
fn parse_mirror(text: &str, n_vertices: usize) -> Result<Vec<u32>, ImportError> {
    let part = "hm08.mirror";
    let mut mirror: Vec<u32> = (0..n_vertices as u32).collect();
    for line in text.lines().filter(|line| !line.trim().is_empty()) {
        let mut fields = line.split_ascii_whitespace();
        let (a, b): (usize, u32) = (parse(fields.next(), part, line)?, parse(fields.next(), part, line)?);
        if a >= n_vertices || b as usize >= n_vertices {
            return Err(bad(part, format!("line `{line}` names a vertex that is not there")));
        }
        mirror[a] = b;
    }
    Ok(mirror)
}

/// The groups `joint-<name>`: one inclusive range of vertices each.
fn parse_cubes(json: &[u8], n_vertices: usize) -> Result<HashMap<String, Range<usize>>, ImportError> {
    let part = "basemesh_vertex_groups.json";
    let groups: HashMap<String, Vec<[usize; 2]>> = serde_json::from_slice(json).map_err(|e| bad(part, e))?;
    let mut cubes = HashMap::new();
    for (name, ranges) in groups {
        let Some(joint) = name.strip_prefix("joint-") else { continue };
        match ranges[..] {
            [[first, last]] if first <= last && last < n_vertices => cubes.insert(joint.to_owned(), first..last + 1),
            _ => return Err(bad(part, format!("{name} is {ranges:?}, expected one range below {n_vertices}"))),
        };
    }
    Ok(cubes)
}

/// `{"vertex_indices": [...], …}`, a pickle in a zip.
fn parse_cavities(bytes: Vec<u8>) -> Result<Vec<usize>, ImportError> {
    let part = "template_mesh_internal_cavities.pth";
    let mut zip = zip::ZipArchive::new(std::io::Cursor::new(bytes)).map_err(|e| bad(part, e))?;
    let name = zip.file_names().flatten().find(|name| name.ends_with("data.pkl")).map(|name| name.into_owned());
    let entry = zip.by_name(&name.unwrap_or_default()).map_err(|e| bad(part, e))?;
    let mut bytes = Vec::new();
    std::io::Read::read_to_end(&mut std::io::Read::take(entry, 1 << 20), &mut bytes).map_err(|e| bad(part, e))?;
    let indices = pickle::parse(&bytes).map_err(|e| bad(part, e))?.value.get("vertex_indices").and_then(|v| v.items());
    let indices = indices.ok_or_else(|| bad(part, "no list `vertex_indices`"))?;
    let indices: Option<Vec<usize>> = indices.iter().map(|v| v.int().and_then(|i| i.try_into().ok())).collect();
    indices.ok_or_else(|| bad(part, "`vertex_indices` is not a list of indices"))
}
