//! `patchlight world --plan` and `patchlight bake --plan`: the jobs of a farm that bakes a world in parts and joins them,
//! or traces the rounds of a scene's bake in parts.

use std::fmt::Write as _;
use std::path::{Path, PathBuf};

use clap::ValueEnum;
use patchlight::rounds::MAX_ROUNDS;
use serde_json::{Value, json};
use shell::Error;
use shell::output;

/// Bytes of a mebibyte, in which both formats count memory.
const MEBIBYTE: u64 = 1 << 20;

/// Who runs the jobs.
#[derive(ValueEnum, Clone, Copy, Debug, PartialEq, Eq)]
pub enum Format {
    /// A batch script of Slurm: `sbatch FILE`.
    Slurm,
    /// A job template of Open Job Description, 2023-09: `openjd run FILE`, AWS Deadline Cloud.
    Openjd,
}

/// Jobs that bake a world in parts and join them.
pub struct Plan {
    /// Number of parts.
    pub parts: u32,
    /// The whole bake, an absolute path.
    pub bake: PathBuf,
    /// Arguments of `patchlight world` that all parts share, from the scene on.
    pub arguments: Vec<String>,
    /// Memory of a job, bytes.
    pub memory: u64,
}

impl Plan {
    /// Writes the jobs beside the bake; where.
    ///
    /// # Errors
    /// A file that cannot be written; paths that the format cannot express.
    pub fn write(&self, format: Format) -> Result<PathBuf, Error> {
        let text = match format {
            Format::Slurm => self.slurm(),
            Format::Openjd => self.openjd()?,
        };
        write_beside(&self.bake, format, &text)
    }

    /// The file of a part, whose number may be one that the farm fills in.
    fn part(&self, number: &str) -> String {
        let file = format!("{}-{number}-of-{}.part.bake", name_of(&self.bake), self.parts);
        self.bake.with_file_name(file).to_string_lossy().into_owned()
    }

    fn megabytes(&self) -> u64 {
        self.memory.div_ceil(MEBIBYTE)
    }

    /// The arguments that join the parts.
    fn merge(&self) -> Vec<String> {
        let parts = (1..=self.parts).map(|number| self.part(&number.to_string()));
        let bake = self.bake.to_string_lossy().into_owned();
        ["merge".to_owned()].into_iter().chain(parts).chain(["-o".to_owned(), bake]).collect()
    }

    fn slurm(&self) -> String {
        let name = name_of(&self.bake);
        let job = job_name(&name);
        let parts = self.parts;
        let memory = self.megabytes();
        let words = |words: &[String]| words.iter().map(|word| quoted(word)).collect::<Vec<_>>().join(" ");
        let bake = words(&self.arguments);
        let merge = words(&self.merge());
        // The shell puts the number between two quoted halves.
        let file = quoted(&self.part("\u{1}")).replacen('\u{1}', "'\"$part\"'", 1);
        let mut text = String::new();
        let _ = write!(
            text,
            r#"#!/bin/bash
# Bakes a world in {parts} jobs, and joins their parts in one that waits for them. PATCHLIGHT names the program. A job that was
# killed goes on where it ended when it is submitted again; a part that is there is not baked again.
#SBATCH --job-name=patchlight-{job}
#SBATCH --array=1-{parts}
#SBATCH --mem={memory}M
#SBATCH --output=%x-%A-%a.log
set -euo pipefail
program=${{PATCHLIGHT:-patchlight}}
part=${{SLURM_ARRAY_TASK_ID:?submit it with sbatch}}
if [ "$part" = 1 ] && [ "${{SLURM_RESTART_COUNT:-0}}" = 0 ]; then
    merge=({merge})
    sbatch --job-name=patchlight-{job}-merge --output=%x-%j.log --mem={memory}M \
        --dependency="afterok:$SLURM_ARRAY_JOB_ID" --wrap="$(printf '%q ' "$program" "${{merge[@]}}")"
fi
file={file}
if [ ! -e "$file" ]; then
    "$program" world {bake} --part "$part/{parts}" -o "$file" --threads "${{SLURM_CPUS_PER_TASK:-1}}"
fi
"#
        );
        text
    }

    fn openjd(&self) -> Result<String, Error> {
        let words = self.arguments.iter().chain([self.part("")].iter()).cloned().collect::<Vec<_>>();
        check_words(&words)?;
        let number = "{{Task.Param.Part}}";
        let options = ["--part".to_owned(), format!("{number}/{}", self.parts), "-o".to_owned(), self.part(number)];
        let bake: Vec<String> =
            ["world".to_owned()].into_iter().chain(self.arguments.iter().cloned()).chain(options).collect();
        let requirements = json!({ "amounts": [{ "name": "amount.worker.memory", "min": self.megabytes() }] });
        let template = json!({
            "specificationVersion": "jobtemplate-2023-09",
            "name": format!("patchlight world {}", name_of(&self.bake)),
            "parameterDefinitions": [{
                "name": "Program",
                "type": "STRING",
                "default": "patchlight",
                "description": "The program on the workers.",
            }],
            "steps": [
                {
                    "name": "Bake",
                    "parameterSpace": {
                        "taskParameterDefinitions": [{ "name": "Part", "type": "INT", "range": format!("1-{}", self.parts) }],
                    },
                    "hostRequirements": requirements,
                    "script": script(bake),
                },
                {
                    "name": "Merge",
                    "dependencies": [{ "dependsOn": "Bake" }],
                    "hostRequirements": requirements,
                    "script": script(self.merge()),
                },
            ],
        });
        Ok(output::json(&template) + "\n")
    }
}

/// Writes jobs beside a bake; where.
fn write_beside(bake: &Path, format: Format, text: &str) -> Result<PathBuf, Error> {
    let path = bake.with_extension(match format {
        Format::Slurm => "sbatch",
        Format::Openjd => "openjd.json",
    });
    output::write_text(&path, text)?;
    Ok(path)
}

/// Name of a bake.
fn name_of(bake: &Path) -> String {
    bake.file_stem().map_or_else(|| String::from("bake"), |stem| stem.to_string_lossy().into_owned())
}

/// A name as Slurm takes it.
fn job_name(name: &str) -> String {
    name.chars().map(|c| if c.is_ascii_alphanumeric() { c } else { '-' }).collect()
}

/// Refuses words that a job template cannot express: an expression begins with two brackets, and there is no way to
/// write them otherwise.
fn check_words(words: &[String]) -> Result<(), Error> {
    match words.iter().find(|word| word.contains("{{")) {
        Some(word) => Err(Error::Unplannable { word: word.clone() }),
        None => Ok(()),
    }
}

/// Script of a step that runs the program with these arguments.
fn script(arguments: Vec<String>) -> Value {
    json!({ "actions": { "onRun": { "command": "{{Param.Program}}", "args": arguments } } })
}

/// Jobs that go on from round to round of a bake, and trace the rows of each in parts.
pub struct RoundPlan {
    /// Number of parts of each round.
    pub parts: u32,
    /// The bake, an absolute path.
    pub bake: PathBuf,
    /// Arguments of `patchlight` that all jobs share.
    pub arguments: Vec<String>,
    /// Memory of a job that goes on, and of one that traces, bytes.
    pub memory: [u64; 2],
}

impl RoundPlan {
    /// Writes the jobs beside the bake; where.
    ///
    /// # Errors
    /// A file that cannot be written; paths that the format cannot express.
    pub fn write(&self, format: Format) -> Result<PathBuf, Error> {
        let text = match format {
            Format::Slurm => self.slurm(),
            Format::Openjd => self.openjd()?,
        };
        write_beside(&self.bake, format, &text)
    }

    /// Arguments of a job that goes on to a round, or with a part traces it.
    fn job(&self, round: &str, part: Option<&str>) -> Vec<String> {
        let round = ["--round".to_owned(), round.to_owned()];
        let part = part.map(|part| ["--part".to_owned(), format!("{part}/{}", self.parts)]);
        self.arguments.iter().cloned().chain(round).chain(part.into_iter().flatten()).collect()
    }

    fn slurm(&self) -> String {
        let name = name_of(&self.bake);
        let job = job_name(&name);
        let [memory, part_memory] = self.memory.map(|memory| memory.div_ceil(MEBIBYTE));
        let words = self.arguments.iter().map(|word| quoted(word)).collect::<Vec<_>>().join(" ");
        let parts = self.parts;
        let rounds = MAX_ROUNDS;
        let end = MAX_ROUNDS + 1;
        format!(
            r#"#!/bin/bash
# Submits the jobs of a bake: for each round one that goes on to it, then {parts} that trace its rows. PATCHLIGHT names the
# program. Jobs of a bake that needs fewer rounds end at once; what was killed goes on when this is submitted again.
#SBATCH --job-name=patchlight-{job}
#SBATCH --output=%x-%j.log
set -euo pipefail
bake=("${{PATCHLIGHT:-patchlight}}" {words})
after=()
for round in {{1..{end}}}; do
    go_on=$(printf '%q ' "${{bake[@]}}" --round "$round")
    id=$(sbatch --parsable --job-name=patchlight-{job}-$round --output=%x-%j.log --mem={memory}M "${{after[@]}}" --wrap="$go_on")
    after=(--dependency="afterok:$id")
    if [ "$round" -le {rounds} ]; then
        trace="${{go_on}}--part "\$SLURM_ARRAY_TASK_ID"/{parts}"
        id=$(sbatch --parsable --job-name=patchlight-{job}-$round-rows --array=1-{parts} --output=%x-%A-%a.log             --mem={part_memory}M "${{after[@]}}" --wrap="$trace")
        after=(--dependency="afterok:$id")
    fi
done
"#
        )
    }

    fn openjd(&self) -> Result<String, Error> {
        check_words(&self.arguments)?;
        let [memory, part_memory] = self
            .memory
            .map(|memory| json!({ "amounts": [{ "name": "amount.worker.memory", "min": memory.div_ceil(MEBIBYTE) }] }));
        let mut steps = Vec::new();
        for round in 1..=MAX_ROUNDS + 1 {
            let number = round.to_string();
            let go_on = if round > MAX_ROUNDS { "End".to_owned() } else { format!("GoOnTo{round}") };
            let mut step = json!({
                "name": go_on,
                "hostRequirements": memory,
                "script": script(self.job(&number, None)),
            });
            if round > 1 {
                step["dependencies"] = json!([{ "dependsOn": format!("Trace{}", round - 1) }]);
            }
            steps.push(step);
            if round <= MAX_ROUNDS {
                let parts = [{ json!({ "name": "Part", "type": "INT", "range": format!("1-{}", self.parts) }) }];
                steps.push(json!({
                    "name": format!("Trace{round}"),
                    "dependencies": [{ "dependsOn": go_on }],
                    "parameterSpace": { "taskParameterDefinitions": parts },
                    "hostRequirements": part_memory,
                    "script": script(self.job(&number, Some("{{Task.Param.Part}}"))),
                }));
            }
        }
        let template = json!({
            "specificationVersion": "jobtemplate-2023-09",
            "name": format!("patchlight bake {}", name_of(&self.bake)),
            "parameterDefinitions": [{
                "name": "Program",
                "type": "STRING",
                "default": "patchlight",
                "description": "The program on the workers.",
            }],
            "steps": steps,
        });
        Ok(output::json(&template) + "\n")
    }
}

/// A word as a shell takes it, whatever is in it.
fn quoted(word: &str) -> String {
    format!("'{}'", word.replace('\'', r"'\''"))
}
