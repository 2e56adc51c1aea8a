//! Embree 4 by its C interface, loaded when the bench runs: the peer of `visibility.rs`.

use std::ffi::c_void;

use libloading::Library;

/// `RTCRayHit`, with room for what later versions append.
#[repr(C, align(64))]
#[derive(Clone, Copy)]
pub struct RayHit {
    origin: [f32; 3],
    near: f32,
    direction: [f32; 3],
    time: f32,
    far: f32,
    mask: u32,
    id: u32,
    flags: u32,
    normal: [f32; 3],
    barycentric: [f32; 2],
    triangle: u32,
    geometry: u32,
    instance: [u32; 9],
}

impl RayHit {
    /// A ray that looks between `near` and `far`.
    pub fn new(origin: [f32; 3], direction: [f32; 3], near: f32, far: f32) -> RayHit {
        RayHit {
            origin,
            near,
            direction,
            time: 0.0,
            far,
            mask: u32::MAX,
            id: 0,
            flags: 0,
            normal: [0.0; 3],
            barycentric: [0.0; 2],
            triangle: u32::MAX,
            geometry: u32::MAX,
            instance: [u32::MAX; 9],
        }
    }
}

type Query = unsafe extern "C" fn(*mut c_void, *mut RayHit, *mut c_void);

/// A scene of triangles in Embree.
pub struct Embree {
    scene: *mut c_void,
    intersect: Query,
    occluded: Query,
    // What Embree reads in place.
    _vertices: Vec<[f32; 4]>,
    _faces: Vec<[u32; 3]>,
    _library: Library,
}

impl Embree {
    /// Builds with Embree's default flags and quality.
    pub fn new(path: &str, vertices: &[[f32; 3]], faces: &[[u32; 3]]) -> Result<Embree, libloading::Error> {
        // A vertex buffer must be readable for 16 bytes at each vertex.
        let vertices: Vec<[f32; 4]> = vertices.iter().map(|&[x, y, z]| [x, y, z, 0.0]).collect();
        let faces = faces.to_vec();
        // SAFETY: the signatures are those of Embree 4's rtcore headers; buffers live as long as the scene.
        unsafe {
            let library = Library::new(path)?;
            let device = library.get::<unsafe extern "C" fn(*const u8) -> *mut c_void>(b"rtcNewDevice")?(
                c"threads=1,set_affinity=0".as_ptr().cast(),
            );
            let scene = library.get::<unsafe extern "C" fn(*mut c_void) -> *mut c_void>(b"rtcNewScene")?(device);
            let geometry =
                library.get::<unsafe extern "C" fn(*mut c_void, u32) -> *mut c_void>(b"rtcNewGeometry")?(device, 0);
            let set = library
                .get::<unsafe extern "C" fn(*mut c_void, u32, u32, u32, *const c_void, usize, usize, usize)>(
                    b"rtcSetSharedGeometryBuffer",
                )?;
            const INDEX: u32 = 0;
            const VERTEX: u32 = 1;
            const UINT3: u32 = 0x5003;
            const FLOAT3: u32 = 0x9003;
            set(geometry, VERTEX, 0, FLOAT3, vertices.as_ptr().cast(), 0, 16, vertices.len());
            set(geometry, INDEX, 0, UINT3, faces.as_ptr().cast(), 0, 12, faces.len());
            library.get::<unsafe extern "C" fn(*mut c_void)>(b"rtcCommitGeometry")?(geometry);
            library.get::<unsafe extern "C" fn(*mut c_void, *mut c_void) -> u32>(b"rtcAttachGeometry")?(
                scene, geometry,
            );
            library.get::<unsafe extern "C" fn(*mut c_void)>(b"rtcCommitScene")?(scene);
            let intersect = *library.get::<Query>(b"rtcIntersect1")?;
            let occluded = *library.get::<Query>(b"rtcOccluded1")?;
            Ok(Embree { scene, intersect, occluded, _vertices: vertices, _faces: faces, _library: library })
        }
    }

    /// The triangle that is hit first.
    pub fn closest(&self, mut ray: RayHit) -> Option<u32> {
        // SAFETY: the scene is committed, the ray is aligned.
        unsafe { (self.intersect)(self.scene, &raw mut ray, std::ptr::null_mut()) };
        (ray.geometry != u32::MAX).then_some(ray.triangle)
    }

    /// Whether anything is hit.
    pub fn blocked(&self, mut ray: RayHit) -> bool {
        // SAFETY: as above.
        unsafe { (self.occluded)(self.scene, &raw mut ray, std::ptr::null_mut()) };
        ray.far < 0.0
    }
}
