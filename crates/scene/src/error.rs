//! Errors of scenes.

/// Why a scene could not be made.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum Error {
    /// There is nothing to light.
    #[error("the scene has no triangles")]
    NoTriangles,
    /// Tables of one value a triangle disagree.
    #[error("{name} holds {found} entries for {expected} triangles")]
    TableLength {
        /// The table.
        name: &'static str,
        /// Triangles.
        expected: usize,
        /// Entries.
        found: usize,
    },
    /// The lighting's emission is not of one value a material.
    #[error("the lighting has an emission for {found} materials of {expected}; give one value a material, or none")]
    EmissionLength {
        /// Materials.
        expected: usize,
        /// Values.
        found: usize,
    },
    /// A part of a luminaire's distribution makes no sense.
    #[error("a light's distribution: {name} {index} is {value}, which must be {rule}")]
    Distribution {
        /// The part concerned.
        name: &'static str,
        /// Which, from 0.
        index: usize,
        /// Its value.
        value: f64,
        /// Rule that it breaks.
        rule: &'static str,
    },
    /// A luminaire's distribution is not in the lighting's table.
    #[error("light {light} has its distribution at {begin}, where the lighting's table of {words} words holds none")]
    LightDistribution {
        /// The light.
        light: usize,
        /// First index.
        begin: u32,
        /// Length of the table.
        words: usize,
    },
    /// Distributions take more room than a device can bind.
    #[error(
        "the distributions of the luminaires take {words} words, {limit} fit; use fewer, or give them fewer angles"
    )]
    Distributions {
        /// Words needed.
        words: usize,
        /// Words that fit.
        limit: usize,
    },
    /// A triangle names a material that does not exist.
    #[error("triangle {triangle} names material {material} of {count}")]
    MaterialIndex {
        /// The triangle.
        triangle: usize,
        /// The name it gives.
        material: u32,
        /// Materials there are.
        count: usize,
    },
    /// A material names a texture that does not exist.
    #[error("material {material} names texture {texture} of {count}")]
    TextureIndex {
        /// The material.
        material: usize,
        /// The name it gives.
        texture: u32,
        /// Textures there are.
        count: usize,
    },
    /// A coordinate is NaN or infinite.
    #[error("triangle {triangle} has a coordinate that is not finite")]
    NotFinite {
        /// The triangle.
        triangle: usize,
    },
    /// A material reflects and transmits more light than it gets, or its optics are no numbers.
    #[error(
        "material {material}: {found}; diffuse reflectance, mirror and transmittance must be from 0 to 1, in each \
         channel 1 at most together, and the index of refraction from 0.1 to 10"
    )]
    Reflectance {
        /// The material.
        material: usize,
        /// Value found.
        found: ReflectanceFault,
    },
    /// There are more finishes than materials.
    #[error("{found} finishes are given for {expected} materials; give one a material at most")]
    FinishLength {
        /// Materials.
        expected: usize,
        /// Finishes.
        found: usize,
    },
    /// A number of a material's finish makes no sense.
    #[error(
        "material {material}: its {name} is {value}; roughness and metallic must be from 0 to 1, and the scale of normals \
         finite"
    )]
    Finish {
        /// The material.
        material: usize,
        /// The number concerned.
        name: &'static str,
        /// Its value.
        value: f32,
    },
    /// The medium between surfaces gives light, or is no number.
    #[error("the absorption of the medium is {value} 1/m in a channel; it must be finite and not below 0")]
    Absorption {
        /// The channel's value.
        value: f32,
    },
    /// A picture from a file that is larger than pictures can be.
    #[error("a texture has more than 32,768 texels in a row or a column, or more than 16 levels")]
    TextureSize,
    /// A hierarchy from elsewhere that is none.
    #[error("the ray hierarchy names a node or a triangle that is not there")]
    Hierarchy,
    /// The hierarchy is deeper than the traversal stack of the kernels.
    #[error(
        "the ray hierarchy has {depth} levels, {limit} fit on the kernels' stack; merge triangles that lie on each \
         other"
    )]
    HierarchyDepth {
        /// Levels.
        depth: usize,
        /// Levels that fit.
        limit: usize,
    },
    /// The number of pixels does not fit the size.
    #[error("{found} pixels given for a picture of {width} x {height}")]
    PixelCount {
        /// Width.
        width: u32,
        /// Height.
        height: u32,
        /// Pixels given.
        found: usize,
    },
    /// Two pictures that should be compared have different sizes.
    #[error(
        "the pictures differ in size: {} x {} and {} x {}; render at the size of the reference",
        ours.0, ours.1, reference.0, reference.1
    )]
    SizeMismatch {
        /// Width and height of the first.
        ours: (u32, u32),
        /// Width and height of the second.
        reference: (u32, u32),
    },
}

/// Fault in the optics of a material.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
pub enum ReflectanceFault {
    /// A share is below 0, or no number.
    #[error("its {name} is {value} in a channel")]
    Share {
        /// Which.
        name: &'static str,
        /// Its value.
        value: f32,
    },
    /// The shares are more than 1.
    #[error(
        "its diffuse reflectance {diffuse}, mirror {mirror} and transmittance {transmittance} are more than 1 \
         together in a channel"
    )]
    Sum {
        /// Diffuse reflectance of the channel, of the brightest texel where there is a texture.
        diffuse: f32,
        /// Mirror.
        mirror: f32,
        /// Transmittance.
        transmittance: f32,
    },
    /// The index of refraction is none.
    #[error("its index of refraction is {value}")]
    Index {
        /// Its value.
        value: f32,
    },
}
