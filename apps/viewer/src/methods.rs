//! The methods that can be chosen, and why the others cannot.

use patchlight::low_level::operator::{Build, Codec, OperatorKey};
use patchlight::method::{FeedbackSettings, FirstShotSettings, LocalSettings, TemporalSettings};
use patchlight::{Bake, MethodSettings};

/// Settings that methods have at first.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct MethodDefaults {
    /// Settings of feedback; its error is that of the operator that the bake has.
    pub feedback: FeedbackSettings,
    /// Settings of temporal radiosity.
    pub temporal: TemporalSettings,
    /// Settings of the matrix round the camera.
    pub local: LocalSettings,
    /// Settings of photons.
    pub first_shot: FirstShotSettings,
}

/// A method in the list.
#[derive(Clone, Debug, PartialEq)]
pub struct MethodChoice {
    /// Its name, as `render` has it; with the codec where a bake may have several.
    pub name: String,
    /// Settings, as edited.
    pub settings: MethodSettings,
    /// Why it cannot be chosen, and what to do about it.
    pub why_not: Option<String>,
}

/// The list, and which is chosen.
#[derive(Clone, Debug, PartialEq)]
pub struct Methods {
    choices: Vec<MethodChoice>,
    chosen: usize,
}

impl Methods {
    /// The methods of a bake. An operator that it does not hold would take long to make: its method cannot be chosen.
    pub fn of(bake: &Bake, defaults: &MethodDefaults) -> Self {
        let mut choices = Vec::new();
        let mut add = |name: &str, settings: MethodSettings, why_not: Option<String>| {
            let why_not = settings.check_medium(bake.scene()).err().map(|error| error.to_string()).or(why_not);
            choices.push(MethodChoice { name: name.to_owned(), settings, why_not });
        };
        add("classic", MethodSettings::Classic, None);
        let held = |settings: &MethodSettings| {
            OperatorKey::of(settings, bake.settings())
                .is_none_or(|key| bake.operators().iter().any(|baked| baked.key == key))
        };
        let codecs: Vec<Codec> = bake.operators().iter().filter_map(|baked| codec_of(&baked.key)).collect();
        let missing = |name: &str| Some(format!("the bake holds no operator for it: bake with --for {name}"));
        let tiles = codecs.iter().find(|codec| matches!(codec, Codec::LowRank { .. }));
        let settings = MethodSettings::Multibounce(
            tiles.copied().unwrap_or(Codec::LowRank { epsilon: defaults.feedback.epsilon }),
        );
        add("low_rank", settings, if held(&settings) { None } else { missing("low_rank") });
        let others: Vec<Codec> = codecs.iter().copied().filter(|c| !matches!(c, Codec::LowRank { .. })).collect();
        for codec in &others {
            add(&format!("multibounce {}", codec.name()), MethodSettings::Multibounce(*codec), None);
        }
        if others.is_empty() {
            let why = missing("multibounce --codec CODEC");
            add("multibounce", MethodSettings::Multibounce(Codec::Dense), why);
        }
        let epsilon = bake.operators().iter().find_map(|baked| match baked.key {
            OperatorKey::FormFactors { epsilon } => Some(epsilon),
            OperatorKey::Bounces { .. } => None,
        });
        let feedback = FeedbackSettings { epsilon: epsilon.unwrap_or(defaults.feedback.epsilon), ..defaults.feedback };
        let settings = MethodSettings::Feedback(feedback);
        add("feedback", settings, if held(&settings) { None } else { missing("feedback") });
        add("temporal", MethodSettings::Temporal(defaults.temporal), None);
        let settings = MethodSettings::Local(defaults.local);
        let patches = bake.mesh().patches.len();
        let memory = settings.check_memory(patches, bake.settings().bounces, &Build::default());
        add("local", settings, memory.err().map(|error| error.to_string()));
        add("firstshot", MethodSettings::FirstShot(defaults.first_shot), None);
        Self { choices, chosen: 0 }
    }

    /// The list.
    pub fn choices(&self) -> &[MethodChoice] {
        &self.choices
    }

    /// The chosen one.
    pub fn chosen(&self) -> &MethodChoice {
        &self.choices[self.chosen]
    }

    /// The settings of the chosen one, to be edited.
    pub fn settings_mut(&mut self) -> &mut MethodSettings {
        &mut self.choices[self.chosen].settings
    }

    /// Chooses a method by its name, or by the first word of it.
    ///
    /// # Errors
    /// Why it cannot be, in words.
    pub fn choose(&mut self, name: &str) -> Result<(), String> {
        let is_begun = |choice: &&(usize, &MethodChoice)| choice.1.name.split(' ').next() == Some(name);
        let all: Vec<(usize, &MethodChoice)> = self.choices.iter().enumerate().collect();
        let found = all.iter().find(|choice| choice.1.name == name).or_else(|| all.iter().find(is_begun));
        let Some(&(index, choice)) = found else {
            let names: Vec<&str> = self.choices.iter().map(|choice| choice.name.as_str()).collect();
            return Err(format!("there is no method `{name}`; choose from {}", names.join(", ")));
        };
        match &choice.why_not {
            Some(why) => Err(format!("{name} cannot be chosen: {why}")),
            None => {
                self.chosen = index;
                Ok(())
            }
        }
    }
}

fn codec_of(key: &OperatorKey) -> Option<Codec> {
    match key {
        OperatorKey::Bounces { codec, .. } => Some(*codec),
        OperatorKey::FormFactors { .. } => None,
    }
}

/// Returns true if light under lights at rest goes on changing from frame to frame.
pub fn goes_on(settings: &MethodSettings) -> bool {
    matches!(settings, MethodSettings::Feedback(_) | MethodSettings::Temporal(_) | MethodSettings::Local(_))
}
