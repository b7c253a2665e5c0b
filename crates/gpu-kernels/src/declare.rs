//! The macro by which a kernel is declared: once, in the file of its method.
//!
//! ```text
//! kernels! {
//!     /// Exitance of every patch after a bounce, W/m²: [`product::bounce`]. One invocation
//!     /// per patch.
//!     TRANSPORT_BOUNCE: BouncePass = "transport_bounce"(p: CountParams) for k in 0..count {
//!         source: read [Rgb; count],
//!         albedo: read [Rgb; count],
//!         irradiance: read [Rgb; count],
//!         exitance: write [Rgb],
//!     } each {
//!         let i = k as usize;
//!         product::bounce(source[i], albedo[i], irradiance[i])
//!     }
//! }
//! ```
//!
//! From this follow the entry point `TRANSPORT_BOUNCE::entry`, the row `TRANSPORT_BOUNCE` of the
//! table, its place in [`KERNELS`](crate::table::KERNELS), the host form, the structure
//! `BouncePass` of what a pass binds ([`pass`](crate::pass)), and what the tests of layout, order
//! and parity go by.
//!
//! # Grammar
//!
//! The head:
//!
//! - `NAME: Pass = "name"`: the name of the row, the type of its passes, and the row's name in small
//!   letters, which names the module and its entry point;
//! - `(p: P)`: push constants, `p` is a `&P`;
//! - `for k in 0..count`: invocation `k` of as many as the field `count` of `P` says; `0..rows * rays`
//!   if their number is a product of two fields;
//! - `for group of N in 0..count, lane`: workgroups that take `N` of `count` each. `group` is the
//!   number of the workgroup, `lane` that of the invocation in it;
//! - `, shared: [T; LENGTH]` after `lane`: memory that a workgroup shares.
//!
//! The bindings, in the order of their numbers:
//!
//! - `b: read [T; length]`: a buffer. The host form refuses one with fewer elements than `length`,
//!   a `usize` in which the fields of `for` (as `usize`) and the bindings before may stand;
//!   with `b: read [T]` any length will do;
//! - `b: write [T]`: a buffer of which every element is written;
//! - `b: update [T]`: a buffer that is read and written. With `b: update [T] as old`, the body of
//!   `each` finds the element's value before in `old`. Several invocations may add to one word by
//!   the functions of [`sums`](crate::sums);
//! - `b: image FORMATS`: a sampled image, with the formats that may be bound;
//! - `geometry: GeometryTables`: the six tables of the scene's geometry, as a `scene::GeometryTables`;
//! - `lights: Lights`: the four tables of what shines, as a `scene::Lights`.
//!
//! What an invocation does:
//!
//! - `each { value }`: the value of element `k` of the buffer that is written or updated; a pair of
//!   values where there are two such buffers;
//! - `each { value } host path;`: the same, with a host form that is faster than a loop;
//! - `invocation { statements } host path;`: it writes by itself, and not just element `k`. The
//!   statements run where `k` is below their number;
//! - `workgroup { statements } host path;`: the statements run in all invocations of all
//!   workgroups, for barriers need all of them.
//!
//! A host form that is written by hand is a function
//! `fn(&Kernel, &mut HostCall) -> Result<(), HostError>` in [`host`](crate::host).

/// Declares the kernels of a method; `src/declare.rs` has the grammar.
#[macro_export]
macro_rules! kernels {
    (@list [$($done:ident)*]) => {
        /// The kernels of this method.
        #[cfg(feature = "std")]
        pub static KERNELS: &[&$crate::table::Kernel] = &[$(&$done),*];
    };
    (@list [$($done:ident)*]
        $(#[$meta:meta])*
        $NAME:ident: $Pass:ident = $name:tt ($p:ident: $P:ty)
        for $k:ident in 0..$count:ident $(* $times:ident)? {
            $($bindings:tt)*
        } each { $($body:tt)* } host $host:path; $($rest:tt)*
    ) => {
        $crate::kernel! {
            @start [
                [$(#[$meta])*] $NAME $Pass $name [$p $P] [$k [$count $($times)?]]
                [each [$($body)*] [$host]] [callable]
            ]
            [$($bindings)*]
        }
        $crate::kernels!(@list [$($done)* $NAME] $($rest)*);
    };
    (@list [$($done:ident)*]
        $(#[$meta:meta])*
        $NAME:ident: $Pass:ident = $name:tt ($p:ident: $P:ty)
        for $k:ident in 0..$count:ident $(* $times:ident)? {
            $($bindings:tt)*
        } each { $($body:tt)* } $($rest:tt)*
    ) => {
        $crate::kernel! {
            @start [
                [$(#[$meta])*] $NAME $Pass $name [$p $P] [$k [$count $($times)?]]
                [each [$($body)*] []] [callable]
            ]
            [$($bindings)*]
        }
        $crate::kernels!(@list [$($done)* $NAME] $($rest)*);
    };
    (@list [$($done:ident)*]
        $(#[$meta:meta])*
        $NAME:ident: $Pass:ident = $name:tt ($p:ident: $P:ty)
        for $k:ident in 0..$count:ident $(* $times:ident)? {
            $($bindings:tt)*
        } invocation { $($body:tt)* } host $host:path; $($rest:tt)*
    ) => {
        $crate::kernel! {
            @start [
                [$(#[$meta])*] $NAME $Pass $name [$p $P] [$k [$count $($times)?]]
                [invocation [$($body)*] [$host]] [callable]
            ]
            [$($bindings)*]
        }
        $crate::kernels!(@list [$($done)* $NAME] $($rest)*);
    };
    (@list [$($done:ident)*]
        $(#[$meta:meta])*
        $NAME:ident: $Pass:ident = $name:tt ($p:ident: $P:ty)
        for $group:ident of $per:tt in 0..$count:ident, $lane:ident {
            $($bindings:tt)*
        } workgroup { $($body:tt)* } host $host:path; $($rest:tt)*
    ) => {
        $crate::kernel! {
            @start [[$(#[$meta])*] $NAME $Pass $name [$p $P] [$group $per [$count] $lane []]
                [workgroup [$($body)*] [$host]] [callable]]
            [$($bindings)*]
        }
        $crate::kernels!(@list [$($done)* $NAME] $($rest)*);
    };
    (@list [$($done:ident)*]
        $(#[$meta:meta])*
        $NAME:ident: $Pass:ident = $name:tt ($p:ident: $P:ty)
        for $group:ident of $per:tt in 0..$count:ident, $lane:ident,
        $shared:ident: [$S:ty; $length:literal] {
            $($bindings:tt)*
        } workgroup { $($body:tt)* } host $host:path; $($rest:tt)*
    ) => {
        $crate::kernel! {
            @start [[$(#[$meta])*] $NAME $Pass $name [$p $P] [
                $group $per [$count] $lane [#[spirv(workgroup)] $shared: &mut [$S; $length]]
            ] [workgroup [$($body)*] [$host]] [device_only]]
            [$($bindings)*]
        }
        $crate::kernels!(@list [$($done)* $NAME] $($rest)*);
    };
    (@list $($wrong:tt)*) => {
        compile_error!(concat!("no kernel (see declare.rs): ", stringify!($($wrong)*)));
    };
    ($($declarations:tt)*) => {
        $crate::kernels!(@list [] $($declarations)*);
    };
}

/// One kernel: first its bindings one by one, then everything that follows from the declaration.
///
/// While bindings are read, these lists grow: parameters of the entry point, rows of the table,
/// names, what the host form reads, what it writes, arguments of an invocation on the host, and
/// structures made of several bindings.
#[doc(hidden)]
#[macro_export]
macro_rules! kernel {
    (@start [$meta:tt $NAME:ident $Pass:ident $name:tt $push:tt $shape:tt $body:tt $callable:tt]
        $bindings:tt
    ) => {
        #[cfg(feature = "std")]
        $crate::typed_pass!(@fields [$meta $NAME $Pass $push] $bindings [] []);
        $crate::kernel! {
            @bind [$meta $NAME $name $push $shape $body] $callable
            [0 1 2 3 4 5 6 7 8 9 10 11 12 13 14 15] $bindings
            [] [] [] [] [] [] []
        }
    };
    (@bind $head:tt $callable:tt $numbers:tt [$geometry:ident: GeometryTables, $($rest:tt)*]
        $params:tt $rows:tt $names:tt $reads:tt $writes:tt $arguments:tt [$($made:tt)*]
    ) => {
        $crate::kernel! {
            @bind $head $callable $numbers [
                nodes: hierarchy,
                triangles: read [$crate::scene_types::gpu::Triangle; 1],
                uvs: read [$crate::scene_types::gpu::TriangleUv; 1],
                materials: read [$crate::scene_types::Material; 1],
                textures: read [$crate::scene_types::gpu::Texture],
                texels: read [u32],
                $($rest)*
            ] $params $rows $names $reads $writes $arguments [
                $($made)*
                let $geometry = $crate::scene_types::GeometryTables {
                    hierarchy: nodes.into(),
                    triangles,
                    uvs,
                    materials,
                    textures,
                    texels,
                };
            ]
        }
    };
    (@bind $head:tt $callable:tt $numbers:tt [$lights:ident: Lights, $($rest:tt)*]
        $params:tt $rows:tt $names:tt $reads:tt $writes:tt $arguments:tt [$($made:tt)*]
    ) => {
        $crate::kernel! {
            @bind $head $callable $numbers [
                lights: read [$crate::scene_types::Light],
                emitters: read [$crate::scene_types::gpu::Emitter],
                sky: read [$crate::scene_types::Sky; 1],
                sky_map: read [$crate::scene_types::Rgb],
                distributions: read [f32],
                $($rest)*
            ] $params $rows $names $reads $writes $arguments [
                $($made)*
                let $lights = $crate::scene_types::Lights { lights, emitters, sky: sky[0], sky_map, distributions };
            ]
        }
    };
    (@bind $head:tt $callable:tt
        [$number:tt $($numbers:tt)*] [$b:ident: hierarchy, $($rest:tt)*]
        [$($params:tt)*] [$($rows:tt)*] [$($names:tt)*] [$($reads:tt)*] $writes:tt
        [$($arguments:tt)*] $made:tt
    ) => {
        $crate::kernel! {
            @bind $head $callable [$($numbers)*] [$($rest)*]
            [
                $($params)*
                #[spirv(storage_buffer, descriptor_set = 0, binding = $number)]
                $b: &[$crate::scene_types::gpu::BvhNode],
            ]
            [
                $($rows)*
                $crate::table::buffer::<$crate::scene_types::gpu::BvhNode>(stringify!($b), $crate::table::Access::Read),
            ]
            [$($names)* $b,]
            [$($reads)* let $b = $b.hierarchy()?;]
            $writes
            [$($arguments)* $b.read::<$crate::scene_types::gpu::BvhNode>(0)?,]
            $made
        }
    };
    (@bind $head:tt $callable:tt
        [$number:tt $($numbers:tt)*] [$b:ident: read [$T:ty $(; $length:expr)?], $($rest:tt)*]
        [$($params:tt)*] [$($rows:tt)*] [$($names:tt)*] [$($reads:tt)*] $writes:tt
        [$($arguments:tt)*] $made:tt
    ) => {
        $crate::kernel! {
            @bind $head $callable [$($numbers)*] [$($rest)*]
            [
                $($params)*
                #[spirv(storage_buffer, descriptor_set = 0, binding = $number)] $b: &[$T],
            ]
            [$($rows)* $crate::table::buffer::<$T>(stringify!($b), $crate::table::Access::Read),]
            [$($names)* $b,]
            [$($reads)* let $b = $b.read::<$T>(0 $(+ $length)?)?;]
            $writes
            [$($arguments)* $b.read::<$T>(0)?,]
            $made
        }
    };
    (@bind $head:tt $callable:tt
        [$number:tt $($numbers:tt)*] [$b:ident: write [$T:ty], $($rest:tt)*]
        [$($params:tt)*] [$($rows:tt)*] [$($names:tt)*] $reads:tt [$($writes:tt)*]
        [$($arguments:tt)*] $made:tt
    ) => {
        $crate::kernel! {
            @bind $head $callable [$($numbers)*] [$($rest)*]
            [
                $($params)*
                #[spirv(storage_buffer, descriptor_set = 0, binding = $number)] $b: &mut [$T],
            ]
            [$($rows)* $crate::table::buffer::<$T>(stringify!($b), $crate::table::Access::Write),]
            [$($names)* $b,]
            $reads
            [$($writes)* [$b $T;]]
            [$($arguments)* $b.whole::<$T>()?,]
            $made
        }
    };
    (@bind $head:tt $callable:tt
        [$number:tt $($numbers:tt)*] [$b:ident: update [$T:ty] $(as $old:ident)?, $($rest:tt)*]
        [$($params:tt)*] [$($rows:tt)*] [$($names:tt)*] $reads:tt [$($writes:tt)*]
        [$($arguments:tt)*] $made:tt
    ) => {
        $crate::kernel! {
            @bind $head $callable [$($numbers)*] [$($rest)*]
            [
                $($params)*
                #[spirv(storage_buffer, descriptor_set = 0, binding = $number)] $b: &mut [$T],
            ]
            [$($rows)* $crate::table::buffer::<$T>(stringify!($b), $crate::table::Access::ReadWrite),]
            [$($names)* $b,]
            $reads
            [$($writes)* [$b $T; $($old)?]]
            [$($arguments)* $b.whole::<$T>()?,]
            $made
        }
    };
    (@bind $head:tt $callable:tt
        [$number:tt $($numbers:tt)*] [$b:ident: image $formats:expr, $($rest:tt)*]
        [$($params:tt)*] [$($rows:tt)*] [$($names:tt)*] $reads:tt $writes:tt $arguments:tt $made:tt
    ) => {
        $crate::kernel! {
            @bind $head [device_only] [$($numbers)*] [$($rest)*]
            [
                $($params)*
                #[spirv(descriptor_set = 0, binding = $number)]
                $b: &spirv_std::Image!(2D, type=f32, sampled),
            ]
            [$($rows)* $crate::table::image(stringify!($b), $formats),]
            [$($names)* $b,]
            $reads $writes $arguments $made
        }
    };

    // Every binding is known.
    (@bind [$meta:tt $NAME:ident $name:tt $push:tt $shape:tt $body:tt] $callable:tt $numbers:tt []
        $params:tt $rows:tt $names:tt $reads:tt $writes:tt $arguments:tt $made:tt
    ) => {
        $crate::kernel!(@row $meta $NAME $name $push $shape $rows $body $callable);
        #[doc(hidden)]
        #[allow(missing_docs, non_snake_case)]
        pub mod $NAME {
            #[allow(unused_imports)]
            use super::*;
            use spirv_std::spirv;
            $crate::kernel!(@entry $name $push $shape $body $params $writes $made);
            #[cfg(feature = "std")]
            $crate::kernel!(@host $push $shape $body $names $reads $writes $made);
            #[cfg(feature = "std")]
            $crate::kernel!(@invocation $callable $push $shape $names $arguments);
        }
    };

    // The row of the table.
    (@row $meta:tt $NAME:ident $name:tt $push:tt [$k:ident $counts:tt]
        $rows:tt [$kind:ident $body:tt $host:tt] $callable:tt
    ) => {
        $crate::kernel! {
            @row $meta $NAME $name $push $counts $crate::invocation::WORKGROUP,
            $rows $host $callable
        }
    };
    (@row $meta:tt $NAME:ident $name:tt $push:tt
        [$group:ident $per:tt $counts:tt $lane:ident $shared:tt] $rows:tt
        [$kind:ident $body:tt $host:tt] $callable:tt
    ) => {
        $crate::kernel!(@row $meta $NAME $name $push $counts $per, $rows $host $callable);
    };
    (@row [$($meta:tt)*] $NAME:ident $name:tt [$p:ident $P:ty] [$($count:ident)*]
        $per:expr, [$($rows:tt)*] $host:tt $callable:tt
    ) => {
        $($meta)*
        #[cfg(feature = "std")]
        pub static $NAME: $crate::table::Kernel = $crate::table::Kernel {
            name: $crate::table::checked_name(stringify!($NAME), $name),
            spv: {
                static MODULE: &$crate::table::Aligned<[u8]> = &$crate::table::Aligned(
                    *include_bytes!(concat!(env!("CARGO_MANIFEST_DIR"), "/spv/", $name, ".spv")),
                );
                &MODULE.0
            },
            workgroup: $crate::invocation::WORKGROUP,
            per_group: $per,
            push_bytes: size_of::<$P>() as u32,
            counts: &[$(core::mem::offset_of!($P, $count)),*],
            bindings: &[$($rows)*],
            host: $crate::kernel!(@host_path $NAME $host),
            invocation: $crate::kernel!(@callable $NAME $callable),
        };
    };
    (@host_path $NAME:ident []) => { $NAME::host };
    (@host_path $NAME:ident [$host:path]) => { $host };
    (@callable $NAME:ident [callable]) => { Some($NAME::invocation) };
    (@callable $NAME:ident [device_only]) => { None };

    // The entry point.
    (@entry $name:tt [$p:ident $P:ty] [$k:ident [$count:ident $($times:ident)*]]
        [each [$($body:tt)*] $host:tt]
        [$($params:tt)*] [[$b:ident $T:ty; $($old:ident)?]] [$($made:tt)*]
    ) => {
        #[spirv(compute(threads(64), entry_point_name = $name))]
        #[inline(never)]
        pub fn entry(
            #[spirv(global_invocation_id)] id: glam::UVec3,
            #[spirv(num_workgroups)] groups: glam::UVec3,
            #[spirv(push_constant)] $p: &$P,
            $($params)*
        ) {
            let $k = $crate::invocation::index(id, groups);
            if $k < $p.$count $(* $p.$times)* {
                $(let $old = $b[$k as usize];)?
                $($made)*
                $b[$k as usize] = { $($body)* };
            }
        }
    };
    (@entry $name:tt [$p:ident $P:ty] [$k:ident [$count:ident $($times:ident)*]]
        [each [$($body:tt)*] $host:tt] [$($params:tt)*]
        [[$a:ident $A:ty; $($old_a:ident)?] [$b:ident $B:ty; $($old_b:ident)?]] [$($made:tt)*]
    ) => {
        #[spirv(compute(threads(64), entry_point_name = $name))]
        #[inline(never)]
        pub fn entry(
            #[spirv(global_invocation_id)] id: glam::UVec3,
            #[spirv(num_workgroups)] groups: glam::UVec3,
            #[spirv(push_constant)] $p: &$P,
            $($params)*
        ) {
            let $k = $crate::invocation::index(id, groups);
            if $k < $p.$count $(* $p.$times)* {
                $(let $old_a = $a[$k as usize];)?
                $(let $old_b = $b[$k as usize];)?
                $($made)*
                let (value_a, value_b) = { $($body)* };
                $a[$k as usize] = value_a;
                $b[$k as usize] = value_b;
            }
        }
    };
    (@entry $name:tt [$p:ident $P:ty] [$k:ident [$count:ident $($times:ident)*]]
        [invocation [$($body:tt)*] $host:tt]
        [$($params:tt)*] $writes:tt [$($made:tt)*]
    ) => {
        #[spirv(compute(threads(64), entry_point_name = $name))]
        #[inline(never)]
        pub fn entry(
            #[spirv(global_invocation_id)] id: glam::UVec3,
            #[spirv(num_workgroups)] groups: glam::UVec3,
            #[spirv(push_constant)] $p: &$P,
            $($params)*
        ) {
            let $k = $crate::invocation::index(id, groups);
            if $k < $p.$count $(* $p.$times)* {
                $($made)*
                $($body)*
            }
        }
    };
    (@entry $name:tt [$p:ident $P:ty] [$group:ident $per:tt $counts:tt $lane:ident [$($shared:tt)*]]
        [workgroup [$($body:tt)*] $host:tt] [$($params:tt)*] $writes:tt [$($made:tt)*]
    ) => {
        #[spirv(compute(threads(64), entry_point_name = $name))]
        #[inline(never)]
        pub fn entry(
            #[spirv(workgroup_id)] id: glam::UVec3,
            #[spirv(num_workgroups)] groups: glam::UVec3,
            #[spirv(local_invocation_index)] $lane: u32,
            #[spirv(push_constant)] $p: &$P,
            $($params)*
            $($shared)*
        ) {
            let $group = $crate::invocation::group_index(id, groups);
            $($made)*
            $($body)*
        }
    };

    // The host form.
    (@host [$p:ident $P:ty] [$k:ident [$($count:ident)*]] [each [$($body:tt)*] []]
        [$($names:tt)*] [$($reads:tt)*] [[$b:ident $T:ty; $($old:ident)?]] [$($made:tt)*]
    ) => {
        #[allow(unused_variables)]
        pub(crate) fn host(
            kernel: &$crate::table::Kernel,
            call: &mut $crate::host::HostCall,
        ) -> Result<(), $crate::host::HostError> {
            let invocations = call.invocations as usize;
            let ($p, [$($names)*]) = call.parts::<$P, _>(kernel)?;
            let $p = &$p;
            $(let $count = $p.$count as usize;)*
            $($reads)*
            $($made)*
            $crate::host::each($b.write::<$T>(invocations)?, |$k, element| {
                $(let $old = *element;)?
                *element = { $($body)* };
            });
            Ok(())
        }
    };
    (@host [$p:ident $P:ty] [$k:ident [$($count:ident)*]] [each [$($body:tt)*] []]
        [$($names:tt)*] [$($reads:tt)*]
        [[$a:ident $A:ty; $($old_a:ident)?] [$b:ident $B:ty; $($old_b:ident)?]] [$($made:tt)*]
    ) => {
        #[allow(unused_variables)]
        pub(crate) fn host(
            kernel: &$crate::table::Kernel,
            call: &mut $crate::host::HostCall,
        ) -> Result<(), $crate::host::HostError> {
            let invocations = call.invocations as usize;
            let ($p, [$($names)*]) = call.parts::<$P, _>(kernel)?;
            let $p = &$p;
            $(let $count = $p.$count as usize;)*
            $($reads)*
            $($made)*
            let $a = $a.write::<$A>(invocations)?;
            let $b = $b.write::<$B>(invocations)?;
            $crate::host::each_pair($a, $b, |$k, element_a, element_b| {
                $(let $old_a = *element_a;)?
                $(let $old_b = *element_b;)?
                (*element_a, *element_b) = { $($body)* };
            });
            Ok(())
        }
    };
    (@host $push:tt $shape:tt [$kind:ident $body:tt [$host:path]]
        $names:tt $reads:tt $writes:tt $made:tt
    ) => {};

    // One invocation of the entry point on the host.
    (@invocation [device_only] $($rest:tt)*) => {};
    (@invocation [callable] [$p:ident $P:ty] [$k:ident $counts:tt]
        [$($names:tt)*] [$($arguments:tt)*]
    ) => {
        pub(crate) fn invocation(
            kernel: &$crate::table::Kernel,
            call: &mut $crate::host::HostCall,
            id: glam::UVec3,
            groups: glam::UVec3,
        ) -> Result<(), $crate::host::HostError> {
            let ($p, [$($names)*]) = call.parts::<$P, _>(kernel)?;
            entry(id, groups, &$p, $($arguments)*);
            Ok(())
        }
    };
    (@invocation [callable] [$p:ident $P:ty] [$group:ident $per:tt $counts:tt $lane:ident []]
        [$($names:tt)*] [$($arguments:tt)*]
    ) => {
        pub(crate) fn invocation(
            kernel: &$crate::table::Kernel,
            call: &mut $crate::host::HostCall,
            id: glam::UVec3,
            groups: glam::UVec3,
        ) -> Result<(), $crate::host::HostError> {
            let ($p, [$($names)*]) = call.parts::<$P, _>(kernel)?;
            let $group = glam::UVec3::new(id.x / kernel.workgroup, id.y, id.z);
            entry($group, groups, id.x % kernel.workgroup, &$p, $($arguments)*);
            Ok(())
        }
    };
}
