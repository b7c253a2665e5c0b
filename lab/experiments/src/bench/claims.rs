//! Claims, by whom they are made, and what is found: docs/data/claims.json, with the numbers of docs/data put in.
//!
//! A number is named by `{EXPERIMENT|SCENE|WHO|FIELD|FORMAT}`. `WHO` is a method or a kind of them, of which the first
//! counts, or `KIND least FIELD`, `KIND greatest FIELD`. `FORMAT` is a number of digits after the point, with `%` for a
//! hundred times as much, `s` for three significant digits, `t` for a text. Arithmetic is division: `{A|… /
//! B|…|FORMAT}`.

use std::collections::BTreeMap;
use std::fmt::Write as _;
use std::path::Path;

use serde::Deserialize;
use serde_json::Value;

use super::study::read;
use crate::error::Error;
use crate::report::significant;

/// Command that makes the file of claims.
const WRITTEN: &str = "report";

/// A claim as it is written.
#[derive(Clone, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Claim {
    pub source: String,
    pub claim: String,
    theirs: String,
    ours: String,
    /// Command that measures ours.
    command: String,
    /// Verdict, where no data decide it.
    #[serde(default)]
    verdict: Option<Verdict>,
    /// It holds if all of these do: `NUMBER < NUMBER` or `NUMBER > NUMBER`.
    #[serde(default)]
    holds_if: Vec<String>,
    pub reason: String,
    /// True if it is made for an opponent, by its authors.
    #[serde(default)]
    pub of_opponent: bool,
}

/// Verdict on a claim.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize)]
pub enum Verdict {
    #[serde(rename = "holds")]
    Holds,
    #[serde(rename = "holds only against a slow baseline")]
    SlowBaseline,
    #[serde(rename = "does not hold")]
    Fails,
    #[serde(rename = "not measured here")]
    NotMeasured,
}

impl Verdict {
    fn text(self) -> &'static str {
        match self {
            Self::Holds => "holds",
            Self::SlowBaseline => "holds only against a slow baseline",
            Self::Fails => "**does not hold**",
            Self::NotMeasured => "not measured here",
        }
    }
}

/// Claims with their numbers and verdicts.
pub struct Claims(Vec<(Claim, Verdict)>);

impl Claims {
    /// Reads a file, with numbers of the experiments' data, from the folder of the file.
    ///
    /// # Errors
    /// [`Error::Data`] for an empty cell, a number that is not there, or a claim without a verdict.
    pub fn read(path: &Path) -> Result<Self, Error> {
        let claims: Vec<Claim> = read(path, WRITTEN)?;
        let folder = path.parent().unwrap_or(Path::new("."));
        let mut numbers = Numbers { folder, records: BTreeMap::new() };
        let mut found = Vec::new();
        for claim in claims {
            let name = claim.claim.clone();
            found.push(numbers.fill(claim).map_err(|why| Error::Data {
                path: path.to_owned(),
                why: format!("`{name}`: {why}"),
                experiment: WRITTEN,
            })?);
        }
        Ok(Self(found))
    }

    /// Those of the project and of its sources that do not hold.
    pub fn failed(&self) -> impl Iterator<Item = &Claim> {
        let failed = self.0.iter().filter(|(claim, verdict)| *verdict == Verdict::Fails && !claim.of_opponent);
        failed.map(|(claim, _)| claim)
    }

    /// As a Markdown table: those of opponents, or the others.
    pub fn table(&self, of_opponents: bool) -> String {
        let mut text = String::from(
            "| claim | source | its number | here | verdict | reason | measured by |\n| --- | --- | --- | --- | --- \
             | --- | --- |\n",
        );
        for (claim, verdict) in self.0.iter().filter(|(claim, _)| claim.of_opponent == of_opponents) {
            let Claim { source, claim, theirs, ours, reason, command, .. } = claim;
            let verdict = verdict.text();
            // Writing into a string cannot fail.
            let _ = writeln!(text, "| {claim} | {source} | {theirs} | {ours} | {verdict} | {reason} | `{command}` |");
        }
        text
    }
}

/// Numbers of docs/data.
struct Numbers<'a> {
    folder: &'a Path,
    /// Records of experiments that were read.
    records: BTreeMap<String, Value>,
}

impl Numbers<'_> {
    /// The claim with all numbers, and its verdict.
    fn fill(&mut self, claim: Claim) -> Result<(Claim, Verdict), String> {
        let verdict = match (claim.verdict, &claim.holds_if[..]) {
            (Some(verdict), []) => verdict,
            (None, []) => return Err("neither verdict nor holds_if".to_owned()),
            (Some(_), _) => return Err("both verdict and holds_if".to_owned()),
            (None, conditions) => {
                let mut holds = true;
                for condition in conditions {
                    holds &= self.compare(condition)?;
                }
                if holds { Verdict::Holds } else { Verdict::Fails }
            }
        };
        let ours = self.text(&claim.ours)?;
        let reason = self.text(&claim.reason)?;
        let cells = [&claim.source, &claim.claim, &claim.theirs, &ours, &claim.command, &reason];
        if cells.into_iter().any(|cell| cell.trim().is_empty()) {
            return Err("an empty cell".to_owned());
        }
        Ok((Claim { ours, reason, ..claim }, verdict))
    }

    /// A text with all numbers.
    fn text(&mut self, template: &str) -> Result<String, String> {
        let mut text = String::new();
        let mut rest = template;
        while let Some((before, after)) = rest.split_once('{') {
            let (name, after) = after.split_once('}').ok_or_else(|| format!("`{{{after}` has no end"))?;
            let (number, format) = name.rsplit_once('|').ok_or_else(|| format!("`{name}` has no format"))?;
            text += before;
            text += &self.shown(number, format)?;
            rest = after;
        }
        Ok(text + rest)
    }

    fn shown(&mut self, name: &str, format: &str) -> Result<String, String> {
        if format == "t" {
            let value = self.value(name)?;
            return value.as_str().map(str::to_owned).ok_or_else(|| format!("`{name}` is no text"));
        }
        let number = self.number(name)?;
        if format == "s" {
            return Ok(significant(number));
        }
        let (digits, factor) = format.strip_suffix('%').map_or((format, 1.0), |digits| (digits, 100.0));
        let digits: usize = digits.parse().map_err(|_| format!("`{format}` is no format"))?;
        Ok(format!("{:.digits$}", factor * number))
    }

    /// A number of the data or a written one, or one over another.
    fn number(&mut self, name: &str) -> Result<f64, String> {
        if let Ok(number) = name.trim().parse() {
            return Ok(number);
        }
        if let Some((above, below)) = name.split_once(" / ") {
            return Ok(self.number(above)? / self.number(below)?);
        }
        self.value(name)?.as_f64().ok_or_else(|| format!("`{name}` is no number"))
    }

    fn compare(&mut self, condition: &str) -> Result<bool, String> {
        if let Some((less, more)) = condition.split_once(" < ") {
            return Ok(self.number(less)? < self.number(more)?);
        }
        let (more, less) = condition.split_once(" > ").ok_or_else(|| format!("`{condition}` compares nothing"))?;
        Ok(self.number(more)? > self.number(less)?)
    }

    fn value(&mut self, name: &str) -> Result<Value, String> {
        let parts: Vec<&str> = name.split('|').map(str::trim).collect();
        let [experiment, scene, who, field] = parts[..] else {
            return Err(format!("`{name}` is not EXPERIMENT|SCENE|WHO|FIELD"));
        };
        let missing = || format!("`{name}` is not in the data of {experiment}");
        let scenes = self.record(experiment)?["scenes"].as_array().ok_or_else(missing)?;
        let scene = scenes.iter().find(|entry| entry["scene"] == scene).ok_or_else(missing)?;
        let row = row_of(scene["rows"].as_array().ok_or_else(missing)?, who).ok_or_else(missing)?;
        let value = field_of(row, field);
        if value.is_null() { Err(missing()) } else { Ok(value.clone()) }
    }

    fn record(&mut self, experiment: &str) -> Result<&Value, String> {
        if !self.records.contains_key(experiment) {
            let path = self.folder.join(format!("{experiment}.json"));
            let record = read(&path, WRITTEN).map_err(|error| error.to_string())?;
            self.records.insert(experiment.to_owned(), record);
        }
        Ok(&self.records[experiment])
    }
}

fn field_of<'a>(row: &'a Value, field: &str) -> &'a Value {
    field.split('.').fold(row, |value, key| &value[key])
}

/// The first row of a method or of a kind of them, or the one of a kind with the least or greatest of a field.
fn row_of<'a>(rows: &'a [Value], who: &str) -> Option<&'a Value> {
    let extreme = |word: &str, sign: f64| {
        let (kind, field) = who.split_once(word)?;
        let of_kind = rows.iter().filter(|row| row["family"] == kind);
        let known = of_kind.filter_map(|row| Some((sign * field_of(row, field).as_f64()?, row)));
        known.min_by(|a, b| a.0.total_cmp(&b.0)).map(|(_, row)| row)
    };
    let named = rows.iter().find(|row| row["family"] == who || row["method"] == who);
    named.or_else(|| extreme(" least ", 1.0)).or_else(|| extreme(" greatest ", -1.0))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Claims of a folder with one experiment of two rows.
    fn claims(change: impl FnOnce(&mut Value)) -> Result<Claims, Error> {
        let folder = tempfile::tempdir().unwrap();
        let row = |family: &str, method: &str, error: f64, ms: f64| {
            let indirect = serde_json::json!({ "error": error });
            serde_json::json!({ "family": family, "method": method, "indirect": indirect, "ms": ms })
        };
        let rows =
            [row("ours", "ours 1", 0.012, 30.0), row("probes", "fine", 0.05, 60.0), row("probes", "coarse", 0.3, 2.0)];
        let record = serde_json::json!({"scenes": [{"scene": "box", "rows": rows}]});
        std::fs::write(folder.path().join("race.json"), record.to_string()).unwrap();
        let mut claim = serde_json::json!({
            "source": "s",
            "claim": "c",
            "theirs": "1",
            "ours": "{race|box|ours|indirect.error|1%} % and {race|box|probes least \
             indirect.error|indirect.error|1%} %, \
                     ×{race|box|probes greatest indirect.error|ms / race|box|ours|ms|s}, {race|box|coarse|method|t}",
            "command": "patchlight bench race",
            "holds_if": ["race|box|ours|indirect.error < race|box|probes least indirect.error|indirect.error"],
            "reason": "r",
        });
        change(&mut claim);
        let path = folder.path().join("claims.json");
        std::fs::write(&path, serde_json::json!([claim]).to_string()).unwrap();
        Claims::read(&path)
    }

    #[test]
    fn numbers_and_verdicts_are_those_of_the_data() {
        let found = claims(|_| {}).unwrap();
        let table = found.table(false);
        assert!(table.contains("| 1.2 % and 5.0 %, ×0.0667, coarse | holds |"), "{table}");
        assert_eq!((found.failed().count(), found.table(true).lines().count()), (0, 2));
        let slower = "race|box|ours|ms / race|box|probes least ms|ms < 0.5";
        let failed = claims(|claim| claim["holds_if"] = serde_json::json!([slower])).unwrap();
        assert!(failed.table(false).contains("**does not hold**"));
        assert_eq!(failed.failed().count(), 1);
        let of_opponent = claims(|claim| {
            claim["holds_if"] = serde_json::json!([slower]);
            claim["of_opponent"] = true.into();
        });
        assert_eq!(of_opponent.unwrap().failed().count(), 0);
    }

    #[test]
    fn a_claim_has_no_gap() {
        let message = |key: &str, value: Value| match claims(|claim| claim[key] = value) {
            Ok(found) => panic!("{key}: {}", found.table(false)),
            Err(error) => error.to_string(),
        };
        assert!(message("ours", " ".into()).contains("an empty cell"));
        assert!(message("ours", "{race|box|nobody|ms|1}".into()).contains("race|box|nobody|ms"));
        assert!(message("ours", "{race|box|ours|ms|x}".into()).contains("`x` is no format"));
        assert!(message("ours", "{race|box".into()).contains("has no end"));
        assert!(message("holds_if", serde_json::json!([])).contains("neither verdict"));
        assert!(message("verdict", "holds".into()).contains("both verdict"));
        assert!(message("verdict", "perhaps".into()).contains("perhaps"));
        assert!(message("holds_if", serde_json::json!(["a"])).contains("compares nothing"));
    }
}
