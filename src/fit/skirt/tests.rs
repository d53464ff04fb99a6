use super::*;
use crate::body::N_POSE;
use crate::ops::skinning::cpu::forward;
use crate::ops::texture_field::TextureFieldConfig;

/// Where a pose turns the thighs outwards, and bends the knees.
const APART: [usize; 2] = [3 * LEFT_HIP + 2, 3 * RIGHT_HIP + 2];
const BENT: [usize; 2] = [3 * LEFT_KNEE, 3 * RIGHT_KNEE];

/// Legs apart as in an A-pose, in two frames that differ a little.
fn standing(body: &Body) -> FitState {
    let pose = |more: f32| {
        let mut pose = [0.0; N_POSE];
        pose[1] = 2.0 + more;
        (pose[APART[0]], pose[APART[1]]) = (0.12 + 0.01 * more, -0.12 - 0.01 * more);
        pose
    };
    let betas = vec![0.0; body.n_betas];
    let poses = [pose(-1.0), pose(1.0)];
    FitState::new(body, betas, &poses, &[[0.0, 0.0, 3.0]; 2], TextureFieldConfig::default(), 0)
}

/// Draws the insides of both legs to the middle, from the crotch to `hem`, with a valley there.
fn wear(body: &Body, state: &mut FitState, hem: f32) {
    let standing = Standing::new(body, state, &state.offsets);
    let dressed: Vec<Vec3> = (0..body.n_vertices())
        .map(|v| {
            let (place, point) = (standing.place(v), Vec3::from(standing.posed.vertices[v]));
            let inside = place.x.abs() < 1.0 && (0.0..hem).contains(&place.y) && !standing.of_arm[v];
            let [left, right] = standing.axes(place.y);
            let (middle, half) = (0.5 * (left + right), standing.half_width(place.y));
            // A leg's inside is less than half as far from its axis as the middle is.
            let near = (1.0 - 2.6 * (1.0 - place.x.abs())).max(0.0);
            let dressed = Vec3 { x: middle + half * near * place.x.signum(), z: point.z * (0.4 + 0.6 * near), ..point };
            if inside { dressed } else { point }
        })
        .collect();
    standing.lay(body, state, &dressed);
}

fn largest_change(a: &[[f32; 3]], b: &[[f32; 3]]) -> f32 {
    a.iter().zip(b).map(|(&a, &b)| Vec3::from(a).distance(b.into())).fold(0.0, f32::max)
}

#[test]
fn a_skirt_is_found_and_bare_legs_are_none() {
    let body = Body::test_body();
    let mut state = standing(&body);
    assert_eq!(Skirt::find(&body, &state), None);
    wear(&body, &mut state, 0.6);
    let hem = Skirt::find(&body, &state).expect("a skirt").hem;
    assert!((0.45..0.65).contains(&hem), "{hem}");
}

#[test]
fn somebody_who_stands_astride_wears_trousers_until_much_is_closed() {
    let body = Body::test_body();
    let mut state = standing(&body);
    for pose in state.poses.chunks_mut(N_POSE) {
        (pose[APART[0]], pose[APART[1]]) = (0.6, -0.6);
    }
    let naked = state.clone();
    wear(&body, &mut state, 0.2);
    assert_eq!(Skirt::find(&body, &state), None);
    let mut state = naked;
    wear(&body, &mut state, 0.6);
    assert!(Skirt::find(&body, &state).is_some());
}

/// Legs together, and cloth around both that hangs away from them: `flare` metres on all sides, from the crotch to the knees.
fn flaring(body: &Body, flare: f32) -> FitState {
    let mut state = standing(body);
    for pose in state.poses.chunks_mut(N_POSE) {
        (pose[APART[0]], pose[APART[1]]) = (-0.03, 0.03);
    }
    wear(body, &mut state, 0.5);
    let standing = Standing::new(body, &state, &state.offsets);
    let out = |v: usize| {
        let (place, point) = (standing.place(v), Vec3::from(standing.posed.vertices[v]));
        if standing.of_arm[v] || !(0.05..0.5).contains(&place.y) {
            return point;
        }
        let [left, right] = standing.axes(place.y);
        let away = Vec3::new(point.x - 0.5 * (left + right), 0.0, point.z);
        point + flare * away.normalize_or_zero() * (1.0 - smoothstep(1.0 - 5.0 * away.x.abs()))
    };
    let vertices: Vec<Vec3> = (0..body.n_vertices()).map(out).collect();
    standing.lay(body, &mut state, &vertices);
    state
}

#[test]
fn a_skirt_over_legs_that_are_close_is_told_by_how_it_flares() {
    let body = Body::test_body();
    let naked = Standing::new(&body, &flaring(&body, 0.0), &vec![0.0; 3 * body.n_vertices()]);
    let gap = naked.section(0.45).iter().map(|p| p.x.abs()).fold(f32::INFINITY, f32::min);
    assert!(2.0 * gap * naked.half_width(0.45) < GAP_M, "the legs are close");
    assert_eq!(Skirt::find(&body, &flaring(&body, 0.015)), None, "trousers");
    let hem = Skirt::find(&body, &flaring(&body, 0.06)).expect("a skirt").hem;
    assert!((0.35..0.55).contains(&hem), "{hem}");
}

#[test]
fn legs_that_touch_are_no_skirt() {
    let body = Body::test_body();
    let mut state = standing(&body);
    for closer in [-0.04, -0.08, -0.12] {
        for pose in state.poses.chunks_mut(N_POSE) {
            (pose[APART[0]], pose[APART[1]]) = (closer, -closer);
        }
        assert_eq!(Skirt::find(&body, &state), None, "{closer}");
    }
    let standing = Standing::new(&body, &state, &state.offsets);
    let between = standing.section(0.9).iter().map(|p| p.x.abs()).fold(f32::INFINITY, f32::min);
    assert!(between * standing.half_width(0.9) < 0.01, "the shanks touch");
}

#[test]
fn a_hung_skirt_stays_where_it_was_and_stays_closed_when_legs_part() {
    let mut body = Body::test_body();
    let mut state = standing(&body);
    wear(&body, &mut state, 0.6);
    let skirt = Skirt::find(&body, &state).unwrap();
    let before = Standing::new(&body, &state, &state.offsets);
    let parted = |body: &Body, state: &FitState| {
        let mut pose = [0.0; N_POSE];
        (pose[APART[0]], pose[APART[1]]) = (0.5, -0.5);
        let posed = forward(body, &state.betas, Some(state.offsets.as_chunks().0), &pose, [0.0; 3]);
        // Of what lay in the middle: how far from it the farthest is now.
        let middle = (0..body.n_vertices()).filter(|&v| {
            let place = before.place(v);
            place.x.abs() < 0.02 && (0.25..skirt.hem - FADE).contains(&place.y) && !before.of_arm[v]
        });
        middle.map(|v| posed.vertices[v][0].abs()).fold(0.0, f32::max)
    };
    let open = parted(&body, &state);
    skirt.hang(&mut body, &mut state);
    body.check().unwrap();
    let after = Standing::new(&body, &state, &state.offsets);
    assert!(largest_change(&before.posed.vertices, &after.posed.vertices) < 1e-4);
    let closed = parted(&body, &state);
    assert!(open > 0.05 && closed < 0.2 * open, "{closed} m, {open} without");
}

#[test]
fn knees_do_not_bend_a_long_skirt() {
    let mut body = Body::test_body();
    let mut state = standing(&body);
    let skirt = Skirt { hem: 0.8 };
    let before = Standing::new(&body, &state, &state.offsets);
    let moved_by_knees = |body: &Body, state: &FitState| {
        let pose = |knees: f32| {
            let mut pose = [0.0; N_POSE];
            (pose[BENT[0]], pose[BENT[1]]) = (knees, knees);
            forward(body, &state.betas, Some(state.offsets.as_chunks().0), &pose, [0.0; 3]).vertices
        };
        let (straight, bent) = (pose(0.0), pose(0.8));
        let hangs = |v: &usize| {
            let place = before.place(*v);
            (0.55..skirt.hem - FADE).contains(&place.y) && !before.of_arm[*v]
        };
        let hanging = (0..body.n_vertices()).filter(hangs);
        hanging.map(|v| Vec3::from(straight[v]).distance(bent[v].into())).fold(0.0, f32::max)
    };
    assert!(moved_by_knees(&body, &state) > 0.05);
    skirt.hang(&mut body, &mut state);
    let moved = moved_by_knees(&body, &state);
    assert!(moved < 1e-3, "{moved} m");
}

#[test]
fn valleys_between_the_legs_are_filled_and_nothing_else_moves() {
    let body = Body::test_body();
    let mut state = standing(&body);
    wear(&body, &mut state, 0.6);
    let skirt = Skirt::find(&body, &state).unwrap();
    let before = Standing::new(&body, &state, &state.offsets);
    skirt.fill(&body, &mut state, |_, outline, x, z| outline.stretched(x, z), ROUNDS);
    let after = Standing::new(&body, &state, &state.offsets);
    let extent = |standing: &Standing| {
        let section = standing.section(0.5 * skirt.hem);
        let z = section.iter().filter(|p| p.x.abs() < MIDDLE).map(|p| p.y);
        let (low, high) = z.fold((f32::INFINITY, f32::NEG_INFINITY), |(l, h), z| (l.min(z), h.max(z)));
        high - low
    };
    assert!(extent(&after) > 1.5 * extent(&before), "{} m deep, {} before", extent(&after), extent(&before));
    for v in 0..body.n_vertices() {
        let place = before.place(v);
        let moved = largest_change(&before.posed.vertices[v..=v], &after.posed.vertices[v..=v]);
        assert!(moved < 1e-4 || place.x.abs() < 1.0 && (0.0..0.7).contains(&place.y), "{place} moved by {moved} m");
    }
}

#[test]
fn what_closes_a_skirt_from_below_is_lifted_between_the_legs() {
    let body = Body::test_body();
    let mut state = standing(&body);
    wear(&body, &mut state, 0.6);
    let skirt = Skirt::find(&body, &state).unwrap();
    let before = Standing::new(&body, &state, &state.offsets);
    skirt.tuck(&body, &mut state);
    let after = Standing::new(&body, &state, &state.offsets);
    let leg = before.height(0) - before.height(2);
    let mut most = 0.0f32;
    for v in 0..body.n_vertices() {
        let lift = (Vec3::from(after.posed.vertices[v]) - Vec3::from(before.posed.vertices[v])) / leg;
        let place = before.place(v);
        assert!(lift.x.abs().max(lift.z.abs()) < 1e-4 && (-1e-4..TUCK + 1e-4).contains(&lift.y), "{place}: {lift}");
        let below = place.x.abs() < LEG && (place.y - skirt.hem).abs() < 2.0 * TUCK;
        assert!(lift.y < 1e-4 || below, "{place} is lifted");
        most = most.max(lift.y);
    }
    assert!(most > 0.5 * TUCK, "{most} of a leg");
}

#[test]
fn halves_of_a_seam_at_different_depths_come_to_the_front_together() {
    let mut body = Body::test_body();
    let mut state = standing(&body);
    wear(&body, &mut state, 0.6);
    let skirt = Skirt::find(&body, &state).unwrap();
    skirt.fill(&body, &mut state, |_, outline, x, z| outline.stretched(x, z), ROUNDS);
    let seam = skirt.cut(&mut body, &mut state);
    let cut = Standing::new(&body, &state, &state.offsets);
    let mut vertices: Vec<Vec3> = cut.posed.vertices.iter().map(|&v| v.into()).collect();
    let in_front = |v: usize| vertices[v].z > 0.04 && (0.25..skirt.hem - FADE).contains(&cut.place(v).y);
    let front: Vec<[usize; 2]> = seam.iter().copied().filter(|pair| pair.iter().all(|&v| in_front(v))).collect();
    assert!(!front.is_empty());
    let closed_from = |vertices: &[Vec3]| {
        let (mut body, mut state) = (body.clone(), state.clone());
        cut.lay(&body, &mut state, vertices);
        skirt.close(&mut body, &mut state, &seam);
        Standing::new(&body, &state, &state.offsets).posed.vertices
    };
    let even = closed_from(&vertices);
    // One half of each pair, then both: these lie 0.65 of the way from back to front.
    for half in 0..2 {
        for pair in &front {
            vertices[pair[half]].z *= 0.3;
        }
        let pressed = closed_from(&vertices);
        for &v in front.iter().flatten() {
            assert!(pressed[v][2] > 0.9 * even[v][2], "{v}: {} m ahead, {} when even", pressed[v][2], even[v][2]);
        }
    }
}

/// Edges of which one face is known alone, vertices in one place counting as one.
fn open_edges(faces: &[[u32; 3]], vertices: &[[f32; 3]]) -> usize {
    let place = |v: u32| vertices[v as usize].map(|x| (x * 1e4).round() as i32);
    let mut edges = std::collections::HashMap::new();
    for &[a, b, c] in faces {
        for edge in [[a, b], [b, c], [c, a]] {
            let mut ends = edge.map(place);
            ends.sort_unstable();
            *edges.entry(ends).or_insert(0) += 1;
        }
    }
    edges.values().filter(|&&n| n == 1).count()
}

#[test]
fn a_tailored_skirt_is_one_piece_without_walls_and_stays_closed() {
    let mut body = Body::test_body();
    let mut state = standing(&body);
    wear(&body, &mut state, 0.6);
    let skirt = Skirt::find(&body, &state).unwrap();
    let within = |body: &Body, state: &FitState| {
        let section = Standing::new(body, state, &state.offsets).section(0.5 * skirt.hem);
        let outline = Outline::of(&section).unwrap();
        let inside = |p: &&glam::Vec2| p.x.abs() < 0.2 && (0.3..0.7).contains(&outline.depth(p.x, p.y));
        section.iter().filter(inside).count()
    };
    assert!(within(&body, &state) > 0, "walls before");
    let all = body.n_faces();
    let before = open_edges(&body.faces, &Standing::new(&body, &state, &state.offsets).posed.vertices);
    skirt.tailor(&mut body, &mut state);
    body.check().unwrap();
    assert!(body.n_faces() < all && state.face_colours.len() == 3 * body.n_faces());
    assert_eq!((body.uv_faces.len(), within(&body, &state)), (body.n_faces(), 0));
    for apart in [0.0, 0.3, 0.6] {
        let mut pose = [0.0; N_POSE];
        (pose[APART[0]], pose[APART[1]]) = (apart, -apart);
        (pose[3 * LEFT_HIP], pose[BENT[0]]) = (-apart, apart);
        let posed = forward(&body, &state.betas, Some(state.offsets.as_chunks().0), &pose, [0.0; 3]);
        assert_eq!(open_edges(&body.faces, &posed.vertices), before, "legs apart by {apart}");
    }
}
