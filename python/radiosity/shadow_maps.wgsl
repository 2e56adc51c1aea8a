// A hemicube of depths a light, and the light that it lets through.
//
// Coordinates are normalised: the scene is a box of size 2 around the origin. A light at y with normal n sees five
// faces, one along n and four halves around it. Depths are NEAR / w, w being the distance along the axis of the face:
// linear on the screen, so that triangles of any size are exact, and the greatest is the nearest.

struct Light {
    // Position; the bound of its geometry term.
    position: vec4f,
    // Tangents, normal.
    x: vec4f,
    y: vec4f,
    z: vec4f,
}

struct Batch {
    width: u32,
    height: u32,
    bands: u32,
    resolution: u32,
    // The lights whose maps are the layers.
    first: u32,
    count: u32,
}

struct Place {
    // Position; 0 where no front is seen, else 1.
    position: vec4f,
    normal: vec4f,
}

@group(0) @binding(0) var<storage, read> lights: array<Light>;
@group(1) @binding(0) var<uniform> batch: Batch;
@group(1) @binding(1) var<storage, read> places: array<Place>;
@group(1) @binding(2) var<storage, read> flux: array<f32>;
@group(1) @binding(3) var<storage, read_write> sums: array<f32>;
@group(1) @binding(4) var maps: texture_depth_2d_array;

// What is nearer to a light casts no shadow.
const NEAR = 2e-4;
// The eye stands so much above the surface, which it does not see.
const LIFT = 1e-5;
// Depths of triangles that come near to the eye are rounded, relative to the greatest depth, NEAR / NEAR.
const ROUNDING = 3e-7;
// More than the half texel that a point may lie beside what its texel holds.
const REACH = 1.05;

// Right, up and forward of a face.
fn frame(light: Light, face: u32) -> mat3x3f {
    let x = light.x.xyz;
    let y = light.y.xyz;
    let z = light.z.xyz;
    switch face {
        case 0u: { return mat3x3f(x, y, z); }
        case 1u: { return mat3x3f(-y, z, x); }
        case 2u: { return mat3x3f(x, z, y); }
        case 3u: { return mat3x3f(y, z, -x); }
        default: { return mat3x3f(-x, z, -y); }
    }
}

fn eye(light: Light) -> vec3f {
    return light.position.xyz + LIFT * light.z.xyz;
}

// The upper left texel of a face in its layer, which is 2 by 1.5 faces large.
fn corner(face: u32, resolution: u32) -> vec2u {
    let half = resolution / 2u;
    switch face {
        case 0u: { return vec2u(0u, 0u); }
        case 1u: { return vec2u(0u, resolution); }
        case 2u: { return vec2u(resolution, 0u); }
        case 3u: { return vec2u(resolution, half); }
        default: { return vec2u(resolution, resolution); }
    }
}

// An instance is a face of a light.
@vertex
fn project(@location(0) position: vec3f, @builtin(instance_index) instance: u32) -> @builtin(position) vec4f {
    let face = instance % 5u;
    let light = lights[instance / 5u];
    let at = transpose(frame(light, face)) * (position - eye(light));
    // The halves begin at the horizon.
    let up = select(2.0 * at.y - at.z, at.y, face == 0u);
    return vec4f(at.x, up, NEAR, at.z);
}

fn is_lit(light: Light, layer: u32, place: Place) -> bool {
    let away = place.position.xyz - eye(light);
    let side = vec2f(dot(away, light.x.xyz), dot(away, light.y.xyz));
    var face = 0u;
    if max(abs(side.x), abs(side.y)) > dot(away, light.z.xyz) {
        face = select(select(4u, 2u, side.y > 0.0), select(3u, 1u, side.x > 0.0), abs(side.x) > abs(side.y));
    }
    let axes = transpose(frame(light, face));
    let normal = axes * place.normal.xyz;
    var at = axes * away;
    // A texel holds the depth of its middle, half a texel away at most, each way: where a plane with this normal is
    // nearer there, it is so by less than if the point lay so much above it.
    let resolution = f32(batch.resolution);
    at += REACH * at.z / resolution * (abs(normal.x) + abs(normal.y)) * normal;
    if at.z <= NEAR {
        return true;
    }
    let u = 0.5 + 0.5 * at.x / at.z;
    let v = 0.5 - 0.5 * at.y / at.z;
    let size = vec2u(batch.resolution, select(batch.resolution / 2u, batch.resolution, face == 0u));
    let texel = min(vec2u(clamp(vec2f(u, v), vec2f(0.0), vec2f(1.0)) * resolution), size - 1u);
    let depth = textureLoad(maps, corner(face, batch.resolution) + texel, layer, 0);
    return depth <= NEAR / at.z + ROUNDING;
}

// Adds what the lights of a batch send to each pixel: min(G, c) V times their flux.
@compute @workgroup_size(8, 8)
fn gather(@builtin(global_invocation_id) id: vec3u) {
    if id.x >= batch.width || id.y >= batch.height {
        return;
    }
    let pixel = id.y * batch.width + id.x;
    let place = places[pixel];
    if place.position.w == 0.0 {
        return;
    }
    for (var layer = 0u; layer < batch.count; layer++) {
        let k = batch.first + layer;
        let light = lights[k];
        let way = light.position.xyz - place.position.xyz;
        let here = dot(place.normal.xyz, way);
        let there = -dot(light.z.xyz, way);
        if here <= 0.0 || there <= 0.0 || !is_lit(light, layer, place) {
            continue;
        }
        let r2 = dot(way, way);
        let term = min(here / r2 * (there / r2), light.position.w);
        for (var band = 0u; band < batch.bands; band++) {
            sums[pixel * batch.bands + band] += term * flux[k * batch.bands + band];
        }
    }
}
