//! Reading SPIR-V words: just what the tests ask of the compiled modules.

use std::collections::{BTreeMap, BTreeSet};

/// Numbers of the SPIR-V specification that the tests name.
#[allow(missing_docs)]
pub mod op {
    pub const SOURCE: u32 = 3;
    pub const NAME: u32 = 5;
    pub const MEMBER_NAME: u32 = 6;
    pub const STRING: u32 = 7;
    pub const LINE: u32 = 8;
    pub const EXT_INST: u32 = 12;
    pub const ENTRY_POINT: u32 = 15;
    pub const EXECUTION_MODE: u32 = 16;
    pub const CAPABILITY: u32 = 17;
    pub const TYPE_INT: u32 = 21;
    pub const TYPE_FLOAT: u32 = 22;
    pub const TYPE_VECTOR: u32 = 23;
    pub const TYPE_IMAGE: u32 = 25;
    pub const TYPE_ARRAY: u32 = 28;
    pub const TYPE_RUNTIME_ARRAY: u32 = 29;
    pub const TYPE_STRUCT: u32 = 30;
    pub const TYPE_POINTER: u32 = 32;
    pub const CONSTANT: u32 = 43;
    pub const VARIABLE: u32 = 59;
    pub const DECORATE: u32 = 71;
    pub const MEMBER_DECORATE: u32 = 72;
    pub const U_CONVERT: u32 = 113;
    pub const F_CONVERT: u32 = 115;
    pub const F_REM: u32 = 140;
    pub const F_MOD: u32 = 141;
}

/// Decorations that the tests name.
#[allow(missing_docs)]
pub mod decoration {
    pub const ARRAY_STRIDE: u32 = 6;
    pub const NON_WRITABLE: u32 = 24;
    pub const BINDING: u32 = 33;
    pub const DESCRIPTOR_SET: u32 = 34;
    pub const OFFSET: u32 = 35;
    pub const NO_CONTRACTION: u32 = 42;
}

/// Storage classes that the tests name.
#[allow(missing_docs)]
pub mod storage {
    pub const UNIFORM_CONSTANT: u32 = 0;
    pub const WORKGROUP: u32 = 4;
    pub const PUSH_CONSTANT: u32 = 9;
    pub const STORAGE_BUFFER: u32 = 12;
}

/// Returns true if `NoContraction` may stand on this operation: float arithmetic.
pub fn is_float_arithmetic(operation: u32) -> bool {
    matches!(operation, 127 | 129 | 131 | 133 | 136 | 140..=148)
}

/// An instruction: its number and operand words.
#[derive(Clone, Debug)]
pub struct Instruction {
    /// Number of the operation.
    pub operation: u32,
    /// Words after the first.
    pub operands: Vec<u32>,
}

/// A variable in a descriptor set.
#[derive(Clone, Debug)]
pub struct Resource {
    /// Number of the binding.
    pub binding: u32,
    /// Descriptor set.
    pub set: u32,
    /// Storage class.
    pub class: u32,
    /// Type that the variable points to.
    pub pointee: u32,
    /// True if it is declared never to be written.
    pub non_writable: bool,
}

/// A parsed module.
#[derive(Debug)]
pub struct Module {
    /// All instructions.
    pub instructions: Vec<Instruction>,
    /// Decorations: (target, member or `u32::MAX`, decoration) → first literal, 0 without one.
    pub decorations: BTreeMap<(u32, u32, u32), u32>,
}

impl Module {
    /// Reads the words of a module; `None` when they are not SPIR-V.
    pub fn parse(bytes: &[u8]) -> Option<Self> {
        let words: Vec<u32> = bytes.chunks_exact(4).map(|b| u32::from_le_bytes([b[0], b[1], b[2], b[3]])).collect();
        if !bytes.len().is_multiple_of(4) || words.first() != Some(&0x0723_0203) {
            return None;
        }
        let mut instructions = Vec::new();
        let mut at = 5;
        while at < words.len() {
            let length = (words[at] >> 16) as usize;
            let operands = words.get(at + 1..at + length)?.to_vec();
            instructions.push(Instruction { operation: words[at] & 0xffff, operands });
            at += length;
        }
        let mut decorations = BTreeMap::new();
        for i in &instructions {
            let o = &i.operands;
            match i.operation {
                op::DECORATE => decorations.insert((o[0], u32::MAX, o[1]), o.get(2).copied().unwrap_or(0)),
                op::MEMBER_DECORATE => decorations.insert((o[0], o[1], o[2]), o.get(3).copied().unwrap_or(0)),
                _ => None,
            };
        }
        Some(Self { instructions, decorations })
    }

    /// All instructions of one operation.
    pub fn all(&self, operation: u32) -> impl Iterator<Item = &[u32]> {
        self.instructions.iter().filter(move |i| i.operation == operation).map(|i| i.operands.as_slice())
    }

    /// Names of the entry points.
    pub fn entry_points(&self) -> Vec<String> {
        self.all(op::ENTRY_POINT)
            .map(|o| {
                let bytes: Vec<u8> = o[2..].iter().flat_map(|w| w.to_le_bytes()).take_while(|b| *b != 0).collect();
                String::from_utf8_lossy(&bytes).into_owned()
            })
            .collect()
    }

    /// `LocalSize` of the only entry point.
    pub fn local_size(&self) -> Option<[u32; 3]> {
        const LOCAL_SIZE: u32 = 17;
        self.all(op::EXECUTION_MODE).find(|o| o[1] == LOCAL_SIZE).map(|o| [o[2], o[3], o[4]])
    }

    /// Capabilities.
    pub fn capabilities(&self) -> BTreeSet<u32> {
        self.all(op::CAPABILITY).map(|o| o[0]).collect()
    }

    fn decoration(&self, id: u32, decoration: u32) -> Option<u32> {
        self.decorations.get(&(id, u32::MAX, decoration)).copied()
    }

    /// The instruction that defines a type: operation and the operands after its id.
    pub fn type_of(&self, id: u32) -> (u32, &[u32]) {
        let is_type = |i: &&Instruction| (19..=39).contains(&i.operation) && i.operands[0] == id;
        let found = self.instructions.iter().find(is_type).expect("every type is defined");
        (found.operation, &found.operands[1..])
    }

    /// Storage buffers and images, by binding.
    pub fn resources(&self) -> Vec<Resource> {
        let mut found: Vec<_> = self
            .all(op::VARIABLE)
            .filter_map(|o| {
                let id = o[1];
                let class = o[2];
                Some(Resource {
                    binding: self.decoration(id, decoration::BINDING)?,
                    set: self.decoration(id, decoration::DESCRIPTOR_SET)?,
                    class,
                    pointee: self.type_of(o[0]).1[1],
                    non_writable: self.decoration(id, decoration::NON_WRITABLE).is_some(),
                })
            })
            .collect();
        found.sort_by_key(|r| r.binding);
        found
    }

    /// Type of the push constants.
    pub fn push_constants(&self) -> Option<u32> {
        let variable = self.all(op::VARIABLE).find(|o| o[2] == storage::PUSH_CONSTANT)?;
        Some(self.type_of(variable[0]).1[1])
    }

    /// The element type and stride of a buffer that is declared as an array without an end.
    pub fn buffer_element(&self, block: u32) -> Option<(u32, u32)> {
        let (operation, members) = self.type_of(block);
        if operation != op::TYPE_STRUCT {
            return None;
        }
        let (operation, element) = self.type_of(members[0]);
        let stride = self.decoration(members[0], decoration::ARRAY_STRIDE)?;
        (operation == op::TYPE_RUNTIME_ARRAY).then(|| (element[0], stride))
    }

    /// Offsets of all scalars in a type, by structures, vectors and arrays, and the end of the last.
    pub fn scalar_offsets(&self, id: u32, base: u32, offsets: &mut Vec<u32>) -> u32 {
        let (operation, o) = self.type_of(id);
        match operation {
            op::TYPE_INT | op::TYPE_FLOAT => {
                offsets.push(base);
                base + o[0] / 8
            }
            op::TYPE_VECTOR => (0..o[1]).fold(base, |at, _| self.scalar_offsets(o[0], at, offsets)),
            op::TYPE_ARRAY => {
                let count = self.all(op::CONSTANT).find(|c| c[1] == o[1]).expect("arrays have constant lengths")[2];
                let stride = self.decoration(id, decoration::ARRAY_STRIDE).expect("arrays in blocks have strides");
                (0..count).fold(base, |_, k| self.scalar_offsets(o[0], base + k * stride, offsets))
            }
            op::TYPE_STRUCT => o.iter().enumerate().fold(base, |_, (k, member)| {
                let offset = self.decorations[&(id, k as u32, decoration::OFFSET)];
                self.scalar_offsets(*member, base + offset, offsets)
            }),
            other => panic!("type of operation {other} in a buffer"),
        }
    }
}
