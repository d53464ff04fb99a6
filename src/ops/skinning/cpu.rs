//! Reference twin, and plain skinning for exporters and renderers ([`forward`]).

use std::borrow::Cow;

use super::rodrigues::{rodrigues, rodrigues_backward};
use crate::body::{Body, N_INFLUENCES, N_JOINTS};
use crate::ops::Real;
use crate::ops::linear::{
    Matrix, Vector, accumulate, add, add_matrix, identity, mul, mul_transposed, outer, product, scale, sub, sub_matrix,
    transpose,
};

/// What of a [`Body`] skinning needs, in any precision.
#[derive(Clone, Debug)]
pub struct Model<'a, T: Real> {
    pub v_template: Cow<'a, [Vector<T>]>,
    /// `[V, 3, B]`
    pub shapedirs: Cow<'a, [T]>,
    /// `[23·9, V·3]` or empty
    pub posedirs: Cow<'a, [T]>,
    pub j_template: Cow<'a, [Vector<T>]>,
    /// `[24, 3, B]`
    pub j_shapedirs: Cow<'a, [T]>,
    pub parents: Cow<'a, [i32]>,
    pub lbs_joints: Cow<'a, [[u32; N_INFLUENCES]]>,
    pub lbs_weights: Cow<'a, [[T; N_INFLUENCES]]>,
}

impl<'a> From<&'a Body> for Model<'a, f32> {
    fn from(body: &'a Body) -> Self {
        Self {
            v_template: Cow::Borrowed(&body.v_template),
            shapedirs: Cow::Borrowed(&body.shapedirs),
            posedirs: Cow::Borrowed(&body.posedirs),
            j_template: Cow::Borrowed(&body.j_template),
            j_shapedirs: Cow::Borrowed(&body.j_shapedirs),
            parents: Cow::Borrowed(&body.parents),
            lbs_joints: Cow::Borrowed(&body.lbs_joints),
            lbs_weights: Cow::Borrowed(&body.lbs_weights),
        }
    }
}

/// The results of [`shape_forward`], T-pose.
#[derive(Clone, Debug)]
pub struct Shape<T> {
    pub v_shaped: Vec<Vector<T>>,
    pub v_deformed: Vec<Vector<T>>,
    pub j_shaped: Vec<Vector<T>>,
}

/// A rigid transform: `x ↦ rotation x + translation`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Transform<T> {
    pub rotation: Matrix<T>,
    pub translation: Vector<T>,
}

/// A posed body.
#[derive(Clone, Debug)]
pub struct Posed<T> {
    /// `[V]`, world
    pub vertices: Vec<Vector<T>>,
    /// `[24]`, world
    pub joints: Vec<Vector<T>>,
    /// `[24]`: `A_j`, T-pose to world, without `transl`.
    pub transforms: Vec<Transform<T>>,
    /// `[V]`, T-pose: with offsets and pose blend shapes.
    pub v_posed: Vec<Vector<T>>,
}

/// What [`pose_backward`] and [`shape_backward`] add to.
#[derive(Clone, Debug)]
pub struct Gradients<T> {
    /// `[V]`
    pub v_deformed: Vec<Vector<T>>,
    /// `[24]`
    pub j_shaped: Vec<Vector<T>>,
    /// `[24]`
    pub pose: Vec<Vector<T>>,
    pub transl: Vector<T>,
    /// `[B]`
    pub betas: Vec<T>,
    /// `[V]`
    pub offsets: Vec<Vector<T>>,
}

impl<T: Real> Gradients<T> {
    pub fn zeros(n_vertices: usize, n_betas: usize) -> Self {
        let zero = [T::zero(); 3];
        Self {
            v_deformed: vec![zero; n_vertices],
            j_shaped: vec![zero; N_JOINTS],
            pose: vec![zero; N_JOINTS],
            transl: zero,
            betas: vec![T::zero(); n_betas],
            offsets: vec![zero; n_vertices],
        }
    }
}

/// Poses `body`: `pose` holds 72 numbers; missing betas count as zero; `offsets` is `[V]` where given.
///
/// # Panics
/// When `pose` or `offsets` has another length.
pub fn forward(body: &Body, betas: &[f32], offsets: Option<&[[f32; 3]]>, pose: &[f32], transl: [f32; 3]) -> Posed<f32> {
    let v_shaped = body.shaped_vertices(betas);
    let v_deformed = match offsets {
        Some(offsets) => {
            assert_eq!(offsets.len(), v_shaped.len(), "offsets");
            v_shaped.iter().zip(offsets).map(|(&v, &d)| add(v, d)).collect()
        }
        None => v_shaped.clone(),
    };
    let shape = Shape { v_shaped, v_deformed, j_shaped: body.shaped_joints(betas) };
    let (pose, rest) = pose.as_chunks();
    assert!(pose.len() == N_JOINTS && rest.is_empty(), "a pose is 72 numbers");
    pose_forward(&Model::from(body), &shape, pose, transl)
}

/// The shaped T-pose: `betas [B]`, `offsets [V]`.
pub fn shape_forward<T: Real>(model: &Model<'_, T>, betas: &[T], offsets: &[Vector<T>]) -> Shape<T> {
    let v_shaped = shaped(&model.v_template, &model.shapedirs, betas);
    let v_deformed = v_shaped.iter().zip(offsets).map(|(&v, &d)| add(v, d)).collect();
    Shape { v_shaped, v_deformed, j_shaped: shaped(&model.j_template, &model.j_shapedirs, betas) }
}

fn shaped<T: Real>(template: &[Vector<T>], dirs: &[T], betas: &[T]) -> Vec<Vector<T>> {
    let mut points = template.to_vec();
    for (value, row) in points.as_flattened_mut().iter_mut().zip(dirs.chunks(betas.len().max(1))) {
        *value += row.iter().zip(betas).map(|(&d, &b)| d * b).sum::<T>();
    }
    points
}

/// One frame: `pose [24]` axis-angle, `transl`.
pub fn pose_forward<T: Real>(
    model: &Model<'_, T>,
    shape: &Shape<T>,
    pose: &[Vector<T>],
    transl: Vector<T>,
) -> Posed<T> {
    let rotations: Vec<Matrix<T>> = pose.iter().map(|&theta| rodrigues(theta)).collect();
    let world = world_transforms(&model.parents, &rotations, &shape.j_shaped);
    let skin = |(g, &j): (&Transform<T>, &Vector<T>)| Transform {
        rotation: g.rotation,
        translation: sub(g.translation, mul(&g.rotation, j)),
    };
    let transforms: Vec<Transform<T>> = world.iter().zip(&shape.j_shaped).map(skin).collect();
    let v_posed = pose_blend(model, &shape.v_deformed, &rotations);
    let vertices = (0..v_posed.len())
        .map(|v| {
            let mut sum = transl;
            for (&j, &w) in model.lbs_joints[v].iter().zip(&model.lbs_weights[v]) {
                let a = &transforms[j as usize];
                accumulate(&mut sum, scale(w, add(mul(&a.rotation, v_posed[v]), a.translation)));
            }
            sum
        })
        .collect();
    let joints = world.iter().map(|g| add(g.translation, transl)).collect();
    Posed { vertices, joints, transforms, v_posed }
}

/// The kinematic chain: `G_j = G_parent · [R_j | J_j − J_parent]`.
fn world_transforms<T: Real>(parents: &[i32], rotations: &[Matrix<T>], joints: &[Vector<T>]) -> Vec<Transform<T>> {
    let mut world: Vec<Transform<T>> = Vec::with_capacity(parents.len());
    for (j, &parent) in parents.iter().enumerate() {
        let Ok(p) = usize::try_from(parent) else {
            world.push(Transform { rotation: rotations[j], translation: joints[j] });
            continue;
        };
        let step = mul(&world[p].rotation, sub(joints[j], joints[p]));
        world.push(Transform {
            rotation: product(&world[p].rotation, &rotations[j]),
            translation: add(world[p].translation, step),
        });
    }
    world
}

fn pose_blend<T: Real>(model: &Model<'_, T>, v_deformed: &[Vector<T>], rotations: &[Matrix<T>]) -> Vec<Vector<T>> {
    let mut v_posed = v_deformed.to_vec();
    if model.posedirs.is_empty() {
        return v_posed;
    }
    let moved = rotations[1..].iter().map(|r| sub_matrix(r, &identity()));
    let feature: Vec<T> = moved.flat_map(|m| m.into_iter().flatten()).collect();
    for (&f, row) in feature.iter().zip(model.posedirs.chunks(3 * v_deformed.len())) {
        for (value, &d) in v_posed.as_flattened_mut().iter_mut().zip(row) {
            *value += f * d;
        }
    }
    v_posed
}

/// Adds to `grads.pose`, `grads.transl`, `grads.v_deformed` and `grads.j_shaped`.
///
/// The chain: with gradients `dG_d = (dR_d, dt_d)` by the world transforms, joint j moves every descendant d (itself too)
/// through `G_d = G_j · rel`, `rel = G_j⁻¹ G_d`, so the whole gradient by `R_j` of the world is
/// `Σ_d dR_d (R_jᵀ R_d)ᵀ + dt_d (R_jᵀ (t_d − t_j))ᵀ = [ Σ_d (dR_d R_dᵀ + dt_d t_dᵀ) − (Σ_d dt_d) t_jᵀ ] R_j`,
/// and by the local rotation that times `R_parentᵀ` from the left.
pub fn pose_backward<T: Real>(
    model: &Model<'_, T>,
    shape: &Shape<T>,
    posed: &Posed<T>,
    pose: &[Vector<T>],
    grad_vertices: &[Vector<T>],
    grad_joints: &[Vector<T>],
    grads: &mut Gradients<T>,
) {
    let zero = Transform { rotation: [[T::zero(); 3]; 3], translation: [T::zero(); 3] };
    let mut grad_transforms = vec![zero; N_JOINTS];
    let mut grad_v_posed = vec![[T::zero(); 3]; grad_vertices.len()];
    for (v, &g) in grad_vertices.iter().enumerate() {
        for (&j, &w) in model.lbs_joints[v].iter().zip(&model.lbs_weights[v]) {
            let g = scale(w, g);
            accumulate(&mut grad_v_posed[v], mul_transposed(&posed.transforms[j as usize].rotation, g));
            let grad = &mut grad_transforms[j as usize];
            grad.rotation = add_matrix(&grad.rotation, &outer(g, posed.v_posed[v]));
            accumulate(&mut grad.translation, g);
        }
        accumulate(&mut grads.v_deformed[v], grad_v_posed[v]);
        accumulate(&mut grads.transl, g);
    }
    for &g in grad_joints {
        accumulate(&mut grads.transl, g);
    }
    let mut grad_rotations = chain_backward(model, shape, posed, &grad_transforms, grad_joints, &mut grads.j_shaped);
    pose_blend_backward(model, &grad_v_posed, &mut grad_rotations);
    for ((grad, &theta), g) in grads.pose.iter_mut().zip(pose).zip(&grad_rotations) {
        accumulate(grad, rodrigues_backward(theta, g));
    }
}

/// Returns the gradients by the local rotations, adds to those by the shaped joints.
fn chain_backward<T: Real>(
    model: &Model<'_, T>,
    shape: &Shape<T>,
    posed: &Posed<T>,
    grad_transforms: &[Transform<T>],
    grad_joints: &[Vector<T>],
    grad_j_shaped: &mut [Vector<T>],
) -> Vec<Matrix<T>> {
    let (n, joints) = (model.parents.len(), &shape.j_shaped);
    let parent = |j: usize| usize::try_from(model.parents[j]).ok();
    let rotation = |j: usize| posed.transforms[j].rotation;
    let translation = |j: usize| add(posed.transforms[j].translation, mul(&rotation(j), joints[j]));
    // Sums over each joint's subtree: children stand behind their parents.
    let mut moments = Vec::with_capacity(n);
    let mut sums = Vec::with_capacity(n);
    for j in 0..n {
        let grad = &grad_transforms[j];
        let grad_rotation = sub_matrix(&grad.rotation, &outer(grad.translation, joints[j]));
        let grad_translation = add(grad.translation, grad_joints[j]);
        moments.push(add_matrix(
            &product(&grad_rotation, &transpose(&rotation(j))),
            &outer(grad_translation, translation(j)),
        ));
        sums.push(grad_translation);
    }
    for j in (0..n).rev() {
        if let Some(p) = parent(j) {
            moments[p] = add_matrix(&moments[p], &moments[j]);
            sums[p] = add(sums[p], sums[j]);
        }
    }
    for j in 0..n {
        // J_j stands in A_j's translation, in its own step from the parent and in its children's steps.
        let mut grad = scale(-T::one(), mul_transposed(&rotation(j), grad_transforms[j].translation));
        let step = parent(j).map_or(sums[j], |p| mul_transposed(&rotation(p), sums[j]));
        accumulate(&mut grad, step);
        accumulate(&mut grad_j_shaped[j], grad);
        if let Some(p) = parent(j) {
            grad_j_shaped[p] = sub(grad_j_shaped[p], step);
        }
    }
    (0..n)
        .map(|j| {
            let whole = product(&sub_matrix(&moments[j], &outer(sums[j], translation(j))), &rotation(j));
            parent(j).map_or(whole, |p| product(&transpose(&rotation(p)), &whole))
        })
        .collect()
}

fn pose_blend_backward<T: Real>(model: &Model<'_, T>, grad_v_posed: &[Vector<T>], grad_rotations: &mut [Matrix<T>]) {
    if model.posedirs.is_empty() {
        return;
    }
    let features = grad_rotations[1..].as_flattened_mut().as_flattened_mut();
    for (feature, row) in features.iter_mut().zip(model.posedirs.chunks(3 * grad_v_posed.len())) {
        *feature += row.iter().zip(grad_v_posed.as_flattened()).map(|(&d, &g)| d * g).sum::<T>();
    }
}

/// Adds to `grads.betas` and `grads.offsets` what `grads.v_deformed` and `grads.j_shaped` have gathered.
pub fn shape_backward<T: Real>(model: &Model<'_, T>, grads: &mut Gradients<T>) {
    let n_betas = grads.betas.len();
    let vertices = model.shapedirs.chunks(n_betas.max(1)).zip(grads.v_deformed.as_flattened());
    let joints = model.j_shapedirs.chunks(n_betas.max(1)).zip(grads.j_shaped.as_flattened());
    for (row, &g) in vertices.chain(joints) {
        for (grad, &d) in grads.betas.iter_mut().zip(row) {
            *grad += d * g;
        }
    }
    for (grad, &g) in grads.offsets.iter_mut().zip(&grads.v_deformed) {
        accumulate(grad, g);
    }
}
