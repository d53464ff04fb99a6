// Four pixels of the whole image an invocation, in three vectors: what `listed` finds. Beyond the last pixel it compares
// that one once more; nobody reads the result.
#import shared/linear_index
#import shared/rgb_params
#import shared/target_pixel

@group(0) @binding(0) var<uniform> params: RgbParams;
@group(0) @binding(1) var<storage, read> image: array<vec4<f32>>;
@group(0) @binding(2) var<storage, read> seen: array<u32>;
@group(0) @binding(3) var<storage, read_write> values: array<vec4<f32>>;
@group(0) @binding(4) var<storage, read_write> grad_image: array<vec4<f32>>;

fn wanted(i: u32) -> vec3<f32> {
    let pixel = params.offset + min(i, params.n_pixels - 1u);
    return target_rgb(pixel, vec3<f32>(params.red, params.green, params.blue), params.composite);
}

@compute @workgroup_size(64)
fn main(@builtin(global_invocation_id) id: vec3<u32>, @builtin(num_workgroups) groups: vec3<u32>) {
    let k = linear_index(id, groups, 64u);
    if 4u * k >= params.n_pixels {
        return;
    }
    let first = image[3u * k];
    let second = image[3u * k + 1u];
    let third = image[3u * k + 2u];
    let off0 = first.xyz - wanted(4u * k);
    let off1 = vec3<f32>(first.w, second.xy) - wanted(4u * k + 1u);
    let off2 = vec3<f32>(second.zw, third.x) - wanted(4u * k + 2u);
    let off3 = third.yzw - wanted(4u * k + 3u);
    values[k] = vec4<f32>(
#for J in 0..4
        abs(off$J.x) + abs(off$J.y) + abs(off$J.z),
#end
    );
    grad_image[3u * k] = params.lambda * vec4<f32>(sign(off0), sign(off1.x));
    grad_image[3u * k + 1u] = params.lambda * vec4<f32>(sign(off1.yz), sign(off2.xy));
    grad_image[3u * k + 2u] = params.lambda * vec4<f32>(sign(off2.z), sign(off3));
}
