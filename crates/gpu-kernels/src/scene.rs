//! Kernels over the scene: rays, direct light, primary visibility, shading, tone mapping.

use ::scene::gpu::{DirectParams, Emitter, EmitterGroup, LargeParams, ShareParams, SpecularChain, WalkParams};
use ::scene::kernel::medium::{Absorbing, Air, transmittance};
use ::scene::kernel::{bvh, camera, large, light, lobe, normal, shade, specular, tone, walk};
use ::scene::{Finish, Hit, Light, Lobe, NONE, Ray, Rgb, Sky, SurfacePoint};
use ::transport::TriangleGrid;
use ::transport::kernel::grid::owner;
use core::f32::consts::FRAC_1_PI;
use glam::Vec3;

use crate::params::{
    CountParams, FollowParams, MediumDirectParams, MediumLargeParams, MeterParams, PixelParams, ToneMapParams,
};

kernels! {
    /// Nearest hit of every ray: [`bvh::closest_hit`]. One invocation per ray.
    SCENE_CLOSEST_HIT: ClosestHitPass = "scene_closest_hit"(p: CountParams) for k in 0..count {
        rays: read [Ray; count],
        geometry: GeometryTables,
        hits: write [Hit],
    } each {
        let ray = rays[k as usize];
        bvh::closest_hit(&geometry, ray.origin, ray.direction, ray.t_max)
    }

    /// 1 for every ray that is stopped, else 0: [`bvh::any_hit`]. One invocation per ray.
    SCENE_ANY_HIT: AnyHitPass = "scene_any_hit"(p: CountParams) for k in 0..count {
        rays: read [Ray; count],
        geometry: GeometryTables,
        stopped: write [u32],
    } each {
        let ray = rays[k as usize];
        bvh::any_hit(&geometry, ray.origin, ray.direction, ray.t_max) as u32
    }

    /// Finds out whether light comes to every place, by random walks: [`walk::reachability`]. One invocation per place.
    SCENE_REACHABILITY: ReachabilityPass = "scene_reachability"(p: WalkParams) for k in 0..count {
        points: read [SurfacePoint; count],
        geometry: GeometryTables,
        lights: read [Light; p.light_count as usize],
        emitters: read [Emitter; p.emitter_count as usize],
        reached: write [u32],
    } each {
        let lamps = walk::Lamps { lights, emitters };
        walk::reachability(&geometry, &lamps, p, points[k as usize])
    }

    /// Direct irradiance at every point, W/m²: [`light::direct_irradiance`] with shadow rays by
    /// [`bvh::any_hit`]. One invocation per point.
    SCENE_DIRECT_LIGHT: DirectLightPass = "scene_direct_light"(p: DirectParams) for k in 0..count {
        points: read [SurfacePoint; count],
        geometry: GeometryTables,
        lights: Lights,
        irradiance: write [Rgb],
    } each {
        let stopped = |origin: Vec3, direction: Vec3, t_max: f32| {
            bvh::any_hit(&geometry, origin, direction, t_max)
        };
        let at = p.first + k;
        light::direct_irradiance(&geometry, p, at, points[k as usize], &lights, Air, stopped).extend(0.0)
    }

    /// Direct light through a medium that absorbs. One invocation per point.
    SCENE_DIRECT_LIGHT_MEDIUM: DirectLightMediumPass = "scene_direct_light_medium"(p: MediumDirectParams) for k in 0..count {
        points: read [SurfacePoint; count],
        geometry: GeometryTables,
        lights: Lights,
        irradiance: write [Rgb],
    } each {
        let stopped = |origin: Vec3, direction: Vec3, t_max: f32| {
            bvh::any_hit(&geometry, origin, direction, t_max)
        };
        let direct = p.direct;
        let medium = Absorbing(p.absorption);
        let at = direct.first + k;
        light::direct_irradiance(&geometry, &direct, at, points[k as usize], &lights, medium, stopped).extend(0.0)
    }

    /// Share of the colour of every light in `changed` that arrives at every point as irradiance:
    /// [`light::share_and_occluder`] with shadow rays by [`bvh::occluder`]. `light_count` says how many have changed;
    /// `shares` and `occluders` hold `count` values for each light; triangles are numbered as the executor numbers
    /// them. One invocation per point.
    SCENE_DIRECT_SHARES: DirectSharesPass = "scene_direct_shares"(p: DirectParams) for k in 0..count {
        points: read [SurfacePoint; count],
        geometry: GeometryTables,
        lights: read [Light],
        distributions: read [f32],
        changed: read [u32; p.light_count as usize],
        shares: update [f32],
        occluders: update [u32],
    } invocation {
        let at = p.first + k;
        for number in 0..p.light_count {
            let slot = changed[number as usize];
            let light = lights[slot as usize];
            let place = (slot * p.count + k) as usize;
            let find = |origin: Vec3, direction: Vec3, t_max: f32, last: u32| {
                bvh::occluder(&geometry, origin, direction, t_max, last)
            };
            let point = points[k as usize];
            let before = occluders[place];
            let (share, occluder) =
                light::share_and_occluder(p, at, slot, &light, distributions, point, before, find);
            shares[place] = share;
            occluders[place] = occluder;
        }
    } host crate::host::scene::direct_shares;

    /// Direct irradiance at every point, W/m², from the shares of the lights and what emitters and sky
    /// send there: [`light::add_lights`]. One invocation per point.
    SCENE_ADD_LIGHTS: AddLightsPass = "scene_add_lights"(p: DirectParams) for k in 0..count {
        lights: read [Light; p.light_count as usize],
        shares: read [f32; p.light_count as usize * count],
        surroundings: read [Rgb; count],
        irradiance: write [Rgb],
    } each {
        light::add_lights(k, p, lights, shares, surroundings[k as usize])
    }

    /// Traces every pixel's primary ray, to a hit and to a point to be lit: [`camera::primary_hit`],
    /// [`normal::shading_point`]. One invocation per pixel.
    SCENE_PRIMARY: PrimaryPass = "scene_primary"(p: PixelParams) for k in 0..count {
        geometry: GeometryTables,
        hits: write [Hit],
        points: write [SurfacePoint],
    } each {
        let at = p.first + k;
        let hit = camera::primary_hit(&geometry, &p.camera, at, p.seed);
        let direction = camera::primary_direction(&p.camera, at, p.seed);
        (hit, normal::shading_point(&geometry, hit, direction))
    }

    /// Albedo of what every pixel's primary ray met: [`shade::pixel_albedo`]. One invocation per pixel.
    SCENE_ALBEDO: AlbedoPass = "scene_albedo"(p: PixelParams) for k in 0..count {
        hits: read [Hit; count],
        geometry: GeometryTables,
        albedo: write [Rgb],
    } each {
        let direction = camera::primary_direction(&p.camera, p.first + k, p.seed);
        shade::pixel_albedo(&geometry, &p.camera, direction, hits[k as usize])
    }

    /// The finish of what every pixel shows: bends the normals, and says what the lobe is: [`lobe::finished`]. One
    /// invocation per pixel.
    SCENE_FINISH: FinishPass = "scene_finish"(p: PixelParams) for k in 0..count {
        hits: read [Hit; count],
        albedo: read [Rgb; count],
        geometry: GeometryTables,
        finishes: read [Finish],
        lights: read [Light; p.light_count as usize],
        points: update [SurfacePoint] as point,
        lobes: write [Lobe],
    } each {
        let hit = hits[k as usize];
        let direction = camera::primary_direction(&p.camera, p.first + k, p.seed);
        let area = shade::seen_area(&geometry, &p.camera, direction, hit);
        let seen = albedo[k as usize];
        let (bent, lobe) = lobe::finished(&geometry, finishes, hit, direction, area, point, seen, Vec3::ONE);
        (bent, lobe::shown(lobe, lights, p.light_count, p.camera.eye, hit))
    }

    /// The finish of what specular paths show: [`lobe::finished`]. One invocation per pixel.
    SCENE_CHAIN_FINISH: ChainFinishPass = "scene_chain_finish"(p: PixelParams) for k in 0..count {
        hits: read [Hit; count],
        chains: read [SpecularChain; count],
        albedo: read [Rgb; count],
        geometry: GeometryTables,
        finishes: read [Finish],
        points: update [SurfacePoint] as point,
        lobes: write [Lobe],
    } each {
        let hit = hits[k as usize];
        let chain = chains[k as usize];
        let direction = chain.direction;
        let area = shade::seen_area(&geometry, &p.camera, direction, hit);
        let seen = albedo[k as usize];
        lobe::finished(&geometry, finishes, hit, direction, area, point, seen, chain.through)
    }

    /// The part of the albedo of every pixel that its lobe leaves to diffuse reflection. One invocation per pixel.
    SCENE_MATTE: MattePass = "scene_matte"(p: CountParams) for k in 0..count {
        lobes: read [Lobe; count],
        albedo: read [Rgb; count],
        matte: write [Rgb],
    } each {
        let seen = albedo[k as usize];
        (seen.truncate() * lobes[k as usize].matte).extend(seen.w)
    }

    /// What the lobe of every pixel sends to the eye of the light of parallel, point and spot lights and luminaires,
    /// W/m²/sr: [`lobe::sharp_light`]. Adds its reflectance to the sum of the sub-frames. One invocation per pixel.
    SCENE_LOBE_SHARP: LobeSharpPass = "scene_lobe_sharp"(p: MediumDirectParams) for k in 0..count {
        points: read [SurfacePoint; count],
        lobes: read [Lobe; count],
        geometry: GeometryTables,
        lights: Lights,
        shine: write [Rgb],
        reflectance: update [Rgb] as reflectance_before,
    } each {
        let stopped = |origin: Vec3, direction: Vec3, t_max: f32| {
            bvh::any_hit(&geometry, origin, direction, t_max)
        };
        let i = k as usize;
        let shine = lobe::sharp_light(&p.direct, p.absorption, points[i], &lobes[i], &lights, stopped);
        let reflectance = lobe::reflectance(&lobes[i], points[i].normal);
        (shine.extend(0.0), reflectance_before + reflectance.extend(0.0))
    }

    /// Adds what the lobe of every pixel sends to the eye of the light of rectangles and emitters, were nothing in the
    /// way, W/m²/sr: [`lobe::open_light`]. One invocation per pixel.
    SCENE_LOBE_OPEN: LobeOpenPass = "scene_lobe_open"(p: LargeParams) for k in 0..count {
        points: read [SurfacePoint; count],
        lobes: read [Lobe; count],
        geometry: GeometryTables,
        lights: Lights,
        groups: read [EmitterGroup],
        open: update [Rgb] as open_before,
    } each {
        let i = k as usize;
        let at = p.first + k;
        open_before + lobe::open_light(&geometry, &lights, groups, p, at, points[i], &lobes[i]).extend(0.0)
    }

    /// Adds what the lobe of every pixel sends to the eye along one ray to the sums of the sub-frames: light of the sky, and
    /// that of what the ray meets, by the exitance of the element there; W/m²/sr: [`lobe::ray`]. One invocation per pixel.
    SCENE_LOBE_RAY: LobeRayPass = "scene_lobe_ray"(p: MediumLargeParams) for k in 0..count {
        points: read [SurfacePoint; count],
        lobes: read [Lobe; count],
        geometry: GeometryTables,
        sky: read [Sky; 1],
        sky_map: read [Rgb],
        grids: read [TriangleGrid],
        cells: read [u32],
        exitance: read [Rgb],
        of_sky: update [Rgb] as sky_before,
        of_surfaces: update [Rgb] as surfaces_before,
    } each {
        let i = k as usize;
        let lobe = lobes[i];
        let point = points[i];
        let mut after = (sky_before, surfaces_before);
        if lobe.alpha > 0.0 {
            let (direction, share) = lobe::ray(&p.large, p.large.first + k, point, &lobe);
            if share.x > 0.0 || share.y > 0.0 || share.z > 0.0 {
                let origin = point.position + point.normal * p.large.ray_offset;
                let hit = bvh::closest_hit(&geometry, origin, direction, bvh::FAR);
                if hit.triangle == NONE {
                    let left = transmittance(p.absorption, bvh::FAR);
                    let light = light::sky_radiance(&sky[0], sky_map, direction);
                    after.0 += (share * left * light).extend(0.0);
                } else {
                    let front = geometry.normal(hit.triangle).dot(direction) < 0.0;
                    let cell = owner(grids[hit.triangle as usize], hit, front);
                    let element = if cell == NONE { NONE } else { cells[cell as usize] };
                    if element != NONE {
                        let left = transmittance(p.absorption, hit.t) * FRAC_1_PI;
                        after.1 += (share * left * exitance[element as usize].truncate()).extend(0.0);
                    }
                }
            }
        }
        after
    }

    /// Adds what the rays of lobes found to the sums of every pixel, averaged over like pixels as shares of large lights
    /// are: [`large::shadowed_light`]. One invocation per pixel.
    SCENE_ADD_LOBES: AddLobesPass = "scene_add_lobes"(p: ShareParams) for k in 0..count {
        points: read [SurfacePoint; p.count_about as usize],
        reflectance: read [Rgb; p.count_about as usize],
        of_sky: read [Rgb; p.count_about as usize],
        of_surfaces: read [Rgb; p.count_about as usize],
        full: update [Rgb] as full_before,
        direct: update [Rgb] as direct_before,
    } each {
        let at = p.first + k;
        let sky = large::shadowed_light(p, at, points, reflectance, of_sky, reflectance).extend(0.0);
        let surfaces = large::shadowed_light(p, at, points, reflectance, of_surfaces, reflectance).extend(0.0);
        (full_before + sky + surfaces, direct_before + sky)
    }

    /// Adds what the lobes sent to the eye of direct light to the sums of every pixel. One invocation per pixel.
    SCENE_ADD_SHINE: AddShinePass = "scene_add_shine"(p: CountParams) for k in 0..count {
        shine: read [Rgb; count],
        full: update [Rgb] as full_before,
        direct: update [Rgb] as direct_before,
    } each {
        let light = shine[k as usize];
        (full_before + light, direct_before + light)
    }

    /// Adds the radiance of one sub-frame to every pixel's sum, W/m²/sr: [`shade::add_sub_frame`].
    /// One invocation per pixel.
    SCENE_SHADE: ShadePass = "scene_shade"(p: PixelParams) for k in 0..count {
        hits: read [Hit; count],
        albedo: read [Rgb; count],
        direct: read [Rgb; count],
        indirect: read [Rgb; count],
        geometry: GeometryTables,
        lights: Lights,
        sum: update [Rgb] as sum_before,
    } each {
        let i = k as usize;
        shade::add_sub_frame(
            &geometry,
            &lights,
            p.light_count,
            &p.camera,
            p.seed,
            p.first + k,
            hits[i],
            albedo[i],
            direct[i],
            indirect[i],
            sum_before,
        )
    }

    /// Follows every pixel's primary ray by way of mirrors and through glass: [`specular::follow_primary`]. One
    /// invocation per pixel.
    SCENE_FOLLOW: FollowPass = "scene_follow"(p: FollowParams) for k in 0..count {
        geometry: GeometryTables,
        lights: Lights,
        hits: write [Hit],
        chains: write [SpecularChain],
    } each {
        let pixels = p.pixels;
        specular::follow_primary(
            &geometry,
            &lights,
            pixels.light_count,
            &pixels.camera,
            pixels.first + k,
            pixels.seed,
            p.ray_offset,
            p.absorption,
        )
    }

    /// Points to be lit where specular paths end, and the albedo there, times the path's factor:
    /// [`normal::shading_point`], [`specular::chain_albedo`]. One invocation per pixel.
    SCENE_CHAIN_SURFACE: ChainSurfacePass = "scene_chain_surface"(p: PixelParams) for k in 0..count {
        hits: read [Hit; count],
        chains: read [SpecularChain; count],
        geometry: GeometryTables,
        points: write [SurfacePoint],
        albedo: write [Rgb],
    } each {
        let hit = hits[k as usize];
        let chain = chains[k as usize];
        let point = normal::shading_point(&geometry, hit, chain.direction);
        (point, specular::chain_albedo(&geometry, &p.camera, hit, chain))
    }

    /// Adds the radiance of one sub-frame to every pixel's sum, W/m²/sr:
    /// [`specular::add_chain_sub_frame`]. One invocation per pixel.
    SCENE_CHAIN_SHADE: ChainShadePass = "scene_chain_shade"(p: CountParams) for k in 0..count {
        chains: read [SpecularChain; count],
        albedo: read [Rgb; count],
        direct: read [Rgb; count],
        indirect: read [Rgb; count],
        sum: update [Rgb] as sum_before,
    } each {
        let i = k as usize;
        specular::add_chain_sub_frame(chains[i], albedo[i], direct[i], indirect[i], sum_before)
    }

    /// Irradiance of every point from the sky, from parallel, point and spot lights and from luminaires, W/m²:
    /// [`large::sharp_irradiance`]. One invocation per point.
    SCENE_SHARP_LIGHT: SharpLightPass = "scene_sharp_light"(p: DirectParams) for k in 0..count {
        points: read [SurfacePoint; count],
        from_sky: read [Rgb; count],
        geometry: GeometryTables,
        lights: Lights,
        irradiance: write [Rgb],
    } each {
        let stopped = |origin: Vec3, direction: Vec3, t_max: f32| {
            bvh::any_hit(&geometry, origin, direction, t_max)
        };
        let i = k as usize;
        let at = p.first + k;
        large::sharp_irradiance(p, at, points[i], &lights, from_sky[i], Air, stopped).extend(0.0)
    }

    /// Sharp direct light through a medium that absorbs. One invocation per point.
    SCENE_SHARP_LIGHT_MEDIUM: SharpLightMediumPass = "scene_sharp_light_medium"(p: MediumDirectParams) for k in 0..count {
        points: read [SurfacePoint; count],
        from_sky: read [Rgb; count],
        geometry: GeometryTables,
        lights: Lights,
        irradiance: write [Rgb],
    } each {
        let stopped = |origin: Vec3, direction: Vec3, t_max: f32| {
            bvh::any_hit(&geometry, origin, direction, t_max)
        };
        let direct = p.direct;
        let medium = Absorbing(p.absorption);
        let i = k as usize;
        let at = direct.first + k;
        large::sharp_irradiance(&direct, at, points[i], &lights, from_sky[i], medium, stopped).extend(0.0)
    }

    /// Adds one sub-frame to every pixel's radiance from rectangles and emitters, were nothing in
    /// the way, W/m²/sr: [`large::add_open_light`]. One invocation per pixel.
    SCENE_OPEN_LIGHT: OpenLightPass = "scene_open_light"(p: LargeParams) for k in 0..count {
        hits: read [Hit; count],
        albedo: read [Rgb; count],
        points: read [SurfacePoint; count],
        geometry: GeometryTables,
        lights: Lights,
        groups: read [EmitterGroup],
        open: update [Rgb] as open_before,
    } each {
        let i = k as usize;
        let at = p.first + k;
        large::add_open_light(&geometry, &lights, groups, p, at, hits[i], albedo[i], points[i], open_before)
    }

    /// Adds one sub-frame to every pixel's samples of rectangles and emitters, those that it sees
    /// and all: [`large::add_seen_light`]. One invocation per pixel.
    SCENE_SEEN_LIGHT: SeenLightPass = "scene_seen_light"(p: LargeParams) for k in 0..count {
        hits: read [Hit; count],
        albedo: read [Rgb; count],
        points: read [SurfacePoint; count],
        geometry: GeometryTables,
        lights: Lights,
        seen: update [Rgb] as seen_before,
        sampled: update [Rgb] as sampled_before,
    } each {
        let stopped = |origin: Vec3, direction: Vec3, t_max: f32| {
            bvh::any_hit(&geometry, origin, direction, t_max)
        };
        let i = k as usize;
        let at = p.first + k;
        let sums = (seen_before, sampled_before);
        large::add_seen_light(&geometry, &lights, p, at, hits[i], albedo[i], points[i], sums, Air, stopped)
    }

    /// Light of visible samples through a medium that absorbs: they count as far as it leaves them. One invocation per
    /// pixel.
    SCENE_SEEN_LIGHT_MEDIUM: SeenLightMediumPass = "scene_seen_light_medium"(p: MediumLargeParams) for k in 0..count {
        hits: read [Hit; count],
        albedo: read [Rgb; count],
        points: read [SurfacePoint; count],
        geometry: GeometryTables,
        lights: Lights,
        seen: update [Rgb] as seen_before,
        sampled: update [Rgb] as sampled_before,
    } each {
        let stopped = |origin: Vec3, direction: Vec3, t_max: f32| {
            bvh::any_hit(&geometry, origin, direction, t_max)
        };
        let large = p.large;
        let medium = Absorbing(p.absorption);
        let i = k as usize;
        let at = large.first + k;
        let sums = (seen_before, sampled_before);
        large::add_seen_light(
            &geometry, &lights, &large, at, hits[i], albedo[i], points[i], sums, medium, stopped,
        )
    }

    /// Marks the pixels about which the share of light that arrives is steady, in the last number of
    /// `open`: [`large::steadiness`]. One invocation per pixel.
    SCENE_MARK_STEADY: MarkSteadyPass = "scene_mark_steady"(p: ShareParams) for k in 0..count {
        points: read [SurfacePoint; p.count_about as usize],
        seen: read [Rgb; p.count_about as usize],
        sampled: read [Rgb; p.count_about as usize],
        open: update [Rgb] as open_before,
    } each {
        open_before.truncate().extend(large::steadiness(p, p.first + k, points, seen, sampled))
    }

    /// Adds the light of rectangles and emitters to every pixel's sums, W/m²/sr:
    /// [`large::shadowed_light`]. One invocation per pixel.
    SCENE_ADD_LARGE_LIGHT: AddLargeLightPass = "scene_add_large_light"(p: ShareParams) for k in 0..count {
        points: read [SurfacePoint; p.count_about as usize],
        open: read [Rgb; p.count_about as usize],
        seen: read [Rgb; p.count_about as usize],
        sampled: read [Rgb; p.count_about as usize],
        full: update [Rgb] as full_before,
        direct: update [Rgb] as direct_before,
    } each {
        let at = p.first + k;
        let light = large::shadowed_light(p, at, points, open, seen, sampled).extend(0.0);
        (full_before + light, direct_before + light)
    }

    /// Displayed colour of every pixel, bytes r, g, b, 255: [`tone::displayed`]. One invocation
    /// per pixel.
    SCENE_TONE_MAP: ToneMapPass = "scene_tone_map"(p: ToneMapParams) for k in 0..count {
        sum: read [Rgb; count],
        pixels: write [u32],
    } each {
        tone::displayed(sum[k as usize], p.scale, p.tone)
    }

    /// Mean luminance of runs of pixels: [`tone::mean_luminance`]. One invocation per run.
    SCENE_METER: MeterPass = "scene_meter"(p: MeterParams) for k in 0..count {
        sum: read [Rgb; p.pixels as usize],
        means: write [f32],
    } each {
        let first = k * p.run;
        let end = if first + p.run < p.pixels { first + p.run } else { p.pixels };
        tone::mean_luminance(sum, first, end)
    }
}
