//! The light on the posed body: its normals, and colours times their shades.

use crate::fit::scene::Scene;
use crate::gpu::{Buffer, Gpu, GpuError, Recorder};
use crate::ops::Topology;
use crate::ops::face_normals::FaceNormals;
use crate::ops::interpolate::Interpolate;
use crate::ops::light::{Exposure, Light, ShadedRows, Shading, Write};

/// A light and what it needs to know of the body. One frame at a time: the scene's last one.
pub struct Lit {
    pub light: Light,
    /// Whether the light is known, so that its shadows alone are to be found.
    pub stands: bool,
    face_normals: FaceNormals,
    shading: Shading,
    /// `[F, 3]`, world space
    on_faces: Buffer<f32>,
    /// `[F, 2]`
    face_parts: Buffer<f32>,
    /// `[V, 3]`, unit, world space
    on_vertices: Buffer<f32>,
    /// `[N][V, 2]`: what reaches each vertex in each frame, as of the last call of [`Lit::set`]. A buffer a frame: all frames
    /// of a long clip are more than some devices bind at once.
    exposures: Vec<Buffer<f32>>,
    /// `[1]`: F
    all_faces: Buffer<u32>,
    n_faces: usize,
}

impl Lit {
    /// A light that reaches everywhere yet, for `n_frames`.
    pub fn new(gpu: &Gpu, faces: &[[u32; 3]], topology: &Topology, n_frames: usize, light: Light) -> Self {
        let face_normals = FaceNormals::new(gpu, faces, topology);
        let n_vertices = topology.corners.len();
        Self {
            light,
            stands: false,
            exposures: (0..n_frames).map(|_| gpu.upload("fit/lit/exposure", &vec![1.0; 2 * n_vertices])).collect(),
            on_faces: face_normals.normals(gpu, "fit/lit/face_normals"),
            face_parts: gpu.zeros("fit/lit/face_parts", 2 * faces.len()),
            on_vertices: gpu.zeros("fit/lit/vertex_normals", 3 * n_vertices),
            all_faces: gpu.upload("fit/lit/all_faces", &[faces.len() as u32]),
            shading: Shading::new(gpu, topology),
            face_normals,
            n_faces: faces.len(),
        }
    }

    /// Takes another light, and what of it reaches each vertex in each frame.
    ///
    /// # Panics
    /// When the exposures are not those of all frames and vertices.
    pub fn set(&mut self, gpu: &Gpu, light: Light, exposures: &[Vec<Exposure>]) {
        assert_eq!(exposures.len(), self.exposures.len(), "exposures of so many frames");
        for (buffer, exposures) in self.exposures.iter().zip(exposures) {
            assert_eq!(2 * exposures.len(), buffer.len(), "{}: vertices", buffer.label());
            gpu.write(buffer, 0, bytemuck::cast_slice(exposures));
        }
        self.light = light;
    }

    /// The same, whose light is not solved anew if it `stands`.
    pub fn standing(self, stands: bool) -> Self {
        Self { stands, ..self }
    }

    /// Records the normals of the scene's body, posed as in `frame`, and the light on its faces.
    pub fn start_frame(&self, recorder: &mut Recorder<'_>, scene: &Scene, frame: usize) {
        self.face_normals.forward(recorder, &scene.posed.vertices, &self.on_faces);
        self.shading.vertex_normals(recorder, &self.on_faces, &self.on_vertices);
        let (normals, parts) = (&self.on_faces, &self.face_parts);
        self.shading.face_parts(recorder, &self.light, &self.exposures[frame], &scene.corners.faces, normals, parts);
    }

    /// Records `shaded = values · shade`, `[F, 3]`.
    pub fn faces(&self, recorder: &mut Recorder<'_>, values: &Buffer<f32>, shaded: &Buffer<f32>, write: Write) {
        let rows = ShadedRows::Counted(&self.all_faces, self.n_faces);
        self.shading.apply(recorder, &self.light, rows, &self.face_parts, values, shaded, write);
    }

    /// Records the parts `[P, 2]` of the shade on the listed pixels of the scene's hard image of `frame`.
    pub fn pixel_parts(
        &self,
        recorder: &mut Recorder<'_>,
        scene: &Scene,
        frame: usize,
        list: &Interpolate,
        n: usize,
        parts: &Buffer<f32>,
    ) {
        let (hard, faces) = (&scene.hard, &scene.corners.faces);
        let (pix_to_face, bary) = (&hard.pix_to_face, &hard.bary_coords);
        let (exposure, normals) = (&self.exposures[frame], &self.on_vertices);
        self.shading.pixel_parts(recorder, &self.light, exposure, list, n, pix_to_face, bary, faces, normals, parts);
    }

    /// Records `shaded = values · shade` of the listed pixels, `[P, 3]`.
    #[expect(clippy::too_many_arguments, reason = "the operands of the contract")]
    pub fn pixels(
        &self,
        recorder: &mut Recorder<'_>,
        list: &Interpolate,
        n: usize,
        parts: &Buffer<f32>,
        values: &Buffer<f32>,
        shaded: &Buffer<f32>,
        write: Write,
    ) {
        let rows = ShadedRows::Listed(list, n);
        self.shading.apply(recorder, &self.light, rows, parts, values, shaded, write);
    }

    /// Unit normals `[F]` of the scene's posed body, world space. Waits.
    pub fn read_face_normals(&self, gpu: &Gpu) -> Result<Vec<[f32; 3]>, GpuError> {
        let normals = gpu.read(&self.on_faces)?;
        let unit = |n: &[f32; 3]| glam::Vec3::from(*n).normalize_or_zero().to_array();
        Ok(normals.as_chunks::<3>().0.iter().map(unit).collect())
    }
}
