//! Settings as flags and configuration files, generated from `voxelastic::settings`.

use crate::failure::Failure;
use anyhow::Context;
use clap::{Arg, ArgMatches, Command};
use std::fs::File;
use std::io::Read;
use std::path::{Path, PathBuf};
use toml::de::{DeTable, DeValue};
use voxelastic::settings::{Group, Setting, Settings, table};

/// Settings that `-h` shows; `--help` shows all.
const IN_SHORT_HELP: [&str; 3] = ["field", "voxel_size", "max_range"];
/// A larger configuration file is a mistake, or a device without end.
const LARGEST_FILE: u64 = 1 << 20;

/// Settings from the command line, and the configuration file for the others.
#[derive(Clone, Debug, Default)]
pub struct SettingFlags {
    given: Vec<(&'static str, String)>,
    file: Option<PathBuf>,
}

impl SettingFlags {
    /// The settings: flags override the file, the file overrides the defaults.
    pub fn resolve(&self) -> anyhow::Result<Settings> {
        self.resolve_over(Settings::default())
    }

    /// As [`resolve`](Self::resolve), with other settings instead of the defaults.
    pub fn resolve_over(&self, mut settings: Settings) -> anyhow::Result<Settings> {
        if let Some(file) = &self.file {
            apply_file(&mut settings, file)?;
        }
        for (key, value) in &self.given {
            settings.set(key, value).map_err(|e| Failure::usage(e.to_string(), "see `voxelastic map --help`"))?;
        }
        settings.validate().map_err(|e| Failure::usage(e.to_string(), "see `voxelastic config` for all settings and their ranges"))?;
        Ok(settings)
    }
}

fn flag(setting: &'static Setting) -> Arg {
    let advanced = setting.group == Group::Advanced;
    let value_name = match setting.unit {
        "" if setting.is_text() => "NAME".to_owned(),
        "" => "N".to_owned(),
        unit => unit.to_uppercase(),
    };
    Arg::new(setting.key)
        .long(setting.key.replace('_', "-"))
        .value_name(value_name)
        .help(format!("{} [{}; default {}]", setting.help, setting.range(), setting.default))
        .help_heading(if advanced { "Advanced settings" } else { "Settings" })
        .hide_short_help(!IN_SHORT_HELP.contains(&setting.key))
        .allow_negative_numbers(true)
        .value_parser(move |text: &str| Settings::default().set(setting.key, text).map(|()| text.to_owned()))
}

impl clap::Args for SettingFlags {
    fn augment_args(command: Command) -> Command {
        let file = Arg::new("config")
            .long("config")
            .value_name("FILE.toml")
            .help("Read settings from this file; flags override it. `voxelastic config` prints one")
            .help_heading("Settings")
            .value_parser(clap::value_parser!(PathBuf));
        table().iter().fold(command.arg(file), |command, setting| command.arg(flag(setting)))
    }

    fn augment_args_for_update(command: Command) -> Command {
        Self::augment_args(command)
    }
}

impl clap::FromArgMatches for SettingFlags {
    fn from_arg_matches(matches: &ArgMatches) -> Result<Self, clap::Error> {
        let given = table().iter().filter_map(|s| Some((s.key, matches.get_one::<String>(s.key)?.clone()))).collect();
        Ok(Self { given, file: matches.get_one::<PathBuf>("config").cloned() })
    }

    fn update_from_arg_matches(&mut self, matches: &ArgMatches) -> Result<(), clap::Error> {
        *self = Self::from_arg_matches(matches)?;
        Ok(())
    }
}

/// Applies a TOML file to the settings.
fn apply_file(settings: &mut Settings, path: &Path) -> anyhow::Result<()> {
    let mut text = String::new();
    let read = File::open(path).and_then(|file| file.take(LARGEST_FILE + 1).read_to_string(&mut text));
    read.with_context(|| format!("cannot read the configuration file {}", path.display()))?;
    if text.len() as u64 > LARGEST_FILE {
        let what = format!("{}: more than {LARGEST_FILE} bytes are no configuration", path.display());
        return Err(Failure::usage(what, "`voxelastic config` prints a file with all settings, their units and ranges").into());
    }
    apply_text(settings, &text).map_err(|(line, what)| {
        let remedy = "`voxelastic config` prints a file with all settings, their units and ranges";
        Failure::usage(format!("{}, line {line}: {what}", path.display()), remedy).into()
    })
}

/// Applies TOML text to the settings; errors hold the line and the problem.
fn apply_text(settings: &mut Settings, text: &str) -> Result<(), (usize, String)> {
    let line_of = |offset: usize| 1 + text.bytes().take(offset).filter(|&b| b == b'\n').count();
    let parsed = DeTable::parse(text).map_err(|e| (line_of(e.span().map_or(0, |s| s.start)), e.message().to_owned()))?;
    for (key, value) in parsed.get_ref() {
        let line = line_of(key.span().start);
        let kind = value.get_ref().type_str();
        let text = match value.get_ref() {
            DeValue::String(text) => text.to_string(),
            DeValue::Integer(number) if number.radix() == 10 => number.as_str().replace('_', ""),
            DeValue::Integer(_) => return Err((line, format!("{} must be written as a decimal number", key.get_ref()))),
            DeValue::Float(number) => number.as_str().replace('_', ""),
            _ => return Err((line, format!("{} is of the type {kind}, but must be a number or a string", key.get_ref()))),
        };
        settings.set(key.get_ref(), &text).map_err(|e| (line, e.to_string()))?;
    }
    Ok(())
}

/// A configuration file with the documentation of all settings.
pub fn documented_toml(settings: &Settings) -> String {
    let mut text =
        String::from("# Settings of `voxelastic map`, for --config FILE. Flags override the file; settings that are left out have their defaults.\n");
    let mut group = None;
    for setting in table() {
        if group != Some(setting.group) {
            group = Some(setting.group);
            text.push_str(if setting.group == Group::Basic { "\n# ---- basic ----\n" } else { "\n# ---- advanced ----\n" });
        }
        let value = settings.get(setting.key).unwrap_or_default();
        let value = if setting.is_text() { toml::Value::String(value).to_string() } else { value };
        text.push_str(&format!("\n# {}\n# {}; default {}.\n{} = {value}\n", setting.help, setting.range(), setting.default, setting.key));
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_documented_file_reads_back_to_the_same_settings() {
        let settings =
            Settings { voxel_size: 0.123_456_79, max_range: 40.0, lambda_odom: 12.5, sensor: "os\"1".into(), threads: 2, ..Settings::default() };
        let mut again = Settings::default();
        apply_text(&mut again, &documented_toml(&settings)).unwrap();
        assert_eq!(again, settings);
        assert!(table().iter().all(|s| documented_toml(&settings).contains(s.help)));
    }

    #[test]
    fn errors_in_a_file_name_the_line() {
        let mistake = |text: &str| apply_text(&mut Settings::default(), text).unwrap_err();
        assert_eq!(mistake("voxel_size = 0.1\nmax_range = 0\n"), (2, "max_range = 0: must be 0.5 to 1000 m".to_owned()));
        assert_eq!(mistake("\n\nvoxels = 0.1"), (3, "there is no setting `voxels`; did you mean `voxel_size`?".to_owned()));
        assert_eq!(mistake("voxel = [1]").1, "voxel is of the type array, but must be a number or a string");
        assert_eq!(mistake("voxel_size = 0.1\nmax_range 3").0, 2);
        assert!(mistake("threads = 0x10").1.contains("decimal"));
        let mut settings = Settings::default();
        apply_text(&mut settings, "lambda_odom = 1_000\nmax_range = 30").unwrap();
        assert_eq!((settings.lambda_odom, settings.max_range), (1000.0, 30.0));
    }
}
