//! `patchlight devices`.

use serde::Serialize;

use shell::Error;
use shell::args::Common;
use shell::output;

use runtime::executor::{DeviceInfo, devices};

#[derive(Serialize)]
struct Row {
    index: Option<usize>,
    name: String,
    kind: String,
    driver: String,
    api_version: String,
    memory_bytes: u64,
    max_storage_buffer_range: u64,
    shared_memory_bytes: u32,
    subgroup_size: u32,
    has_timestamps: bool,
    missing_feature: Option<&'static str>,
}

impl Row {
    fn of(d: &DeviceInfo) -> Self {
        Self {
            index: d.index,
            name: d.name.clone(),
            kind: d.kind.to_string(),
            driver: d.driver.clone(),
            api_version: d.api_version.clone(),
            memory_bytes: d.memory_bytes,
            max_storage_buffer_range: d.max_storage_buffer_range,
            shared_memory_bytes: d.shared_memory_bytes,
            subgroup_size: d.subgroup_size,
            has_timestamps: d.has_timestamps,
            missing_feature: d.missing_feature,
        }
    }
}

pub fn run(common: &Common) -> Result<(), Error> {
    let (found, note) = devices();
    let rows: Vec<Row> = found.iter().map(Row::of).collect();
    if common.json {
        say!("{}", output::json(&rows));
        return Ok(());
    }
    for row in &rows {
        let index = row.index.map_or_else(|| "cpu".to_owned(), |k| k.to_string());
        say!("{index:>4}  {} ({})", row.name, row.kind);
        if row.index.is_some() {
            say!("      driver {}, Vulkan {}", row.driver, row.api_version);
            say!(
                "      memory {}, largest binding {}, shared memory {}, subgroups of {}{}",
                output::bytes(row.memory_bytes),
                output::bytes(row.max_storage_buffer_range),
                output::bytes(u64::from(row.shared_memory_bytes)),
                row.subgroup_size,
                if row.has_timestamps { "" } else { ", no timestamps" }
            );
        }
        if let Some(feature) = row.missing_feature {
            say!("      cannot be used: it lacks {feature}");
        }
    }
    if let Some(note) = note {
        say!("no Vulkan: {note}");
    }
    Ok(())
}
