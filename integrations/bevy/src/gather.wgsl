// Texels of a lightmap, or of an irradiance volume, from the light of the points that each takes it from.

struct Row {
    points: array<u32, 3>,
    weights: array<f32, 3>,
}

// Irradiance, W/m², at points.
@group(0) @binding(0) var<storage, read> source: array<vec4<f32>>;
// Points of each receiver.
@group(0) @binding(1) var<storage, read> rows: array<Row>;
// What it gets besides, RGB.
@group(0) @binding(2) var<storage, read> base: array<f32>;
// Receiver of each texel.
@group(0) @binding(3) var<storage, read> shown: array<u32>;
// Half floats, row by row.
@group(0) @binding(4) var<storage, read_write> texels: array<vec2<u32>>;
// Texels of a row, and from a row to the next.
@group(0) @binding(5) var<uniform> size: vec4<u32>;

const ONE_OVER_PI: f32 = 0.31830987;
const LARGEST_HALF: f32 = 65504.0;

@compute @workgroup_size(64)
fn gather(@builtin(global_invocation_id) at: vec3<u32>) {
    if at.x >= size.x {
        return;
    }
    let receiver = shown[at.y * size.x + at.x];
    var light = vec3<f32>(0.0);
    if receiver < arrayLength(&rows) {
        light = vec3<f32>(base[3u * receiver], base[3u * receiver + 1u], base[3u * receiver + 2u]);
        for (var k = 0u; k < 3u; k++) {
            light += rows[receiver].weights[k] * source[rows[receiver].points[k]].xyz;
        }
    }
    // Radiance of a white surface.
    let white = min(light * ONE_OVER_PI, vec3<f32>(LARGEST_HALF));
    texels[at.y * size.y + at.x] = vec2<u32>(pack2x16float(white.xy), pack2x16float(vec2<f32>(white.z, 1.0)));
}
