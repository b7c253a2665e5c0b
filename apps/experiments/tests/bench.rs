//! Experiments as a user meets them.

mod program;

use program::{fails, leftovers, succeeds};
use reference::{Picture, PictureFile as _, Precision};

fn parts(list: &[String]) -> Vec<&str> {
    list.iter().map(String::as_str).collect()
}

#[test]
fn the_bench_of_patches_writes_its_tables_plots_and_report() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().to_str().unwrap();
    let mut arguments = vec!["patches", "cornell", "--out", out, "--device", "cpu", "--quiet"];
    arguments.extend(["--size", "160x120", "--spp", "8", "--sub-frames", "1", "--frames", "1", "--counts", "200,400"]);
    arguments.extend(["--densities", "1", "--rays", "64", "--receiver-rays", "32", "--kinds", "axis,cluster"]);
    let markdown = succeeds(&arguments);
    assert!(markdown.contains("## cornell") && markdown.contains("| voxel proxy |"), "{markdown}");
    let text = std::fs::read_to_string(folder.path().join("summary.json")).unwrap();
    let summary: serde_json::Value = serde_json::from_str(&text).unwrap();
    assert_eq!(summary["name"], "patches");
    assert!(summary["machine"]["cpu"].is_string() && summary["machine"]["stream_gb_s"].as_f64().unwrap() > 0.1);
    let rows = summary["rows"].as_array().unwrap();
    let of = |part: &str| rows.iter().filter(|r| r["part"] == part).collect::<Vec<_>>();
    // Two kinds of two sizes, one of them also as its own receivers, the proxy with two lookups.
    assert_eq!(of("patches").len(), 2 * 2 + 2 + 2 * 2);
    assert_eq!((of("break-down").len(), of("lights").len()), (6, 3));
    for row in rows {
        let number = |key: &str| row[key].as_f64().unwrap_or_else(|| panic!("{key}: {row}"));
        let is_proxy = row["method"] == "voxel proxy";
        let ratio = number("indirect_mean_ratio");
        let bound = if is_proxy { 4.0 } else { 1.25 };
        assert!((1.0 / bound..bound).contains(&ratio), "{row}");
        assert!(number("indirect_block_median") > 0.0 && number("indirect_psnr_db") > 5.0);
        assert_eq!(row.get("bytes").is_some(), !is_proxy);
        assert!(row["reference_noise"]["block_psnr_db"].as_f64().unwrap() > 10.0);
    }
    // Far from the truth, where patches of the true surface are near.
    let median = |method: &str| {
        let of_method = of("patches").into_iter().filter(|r| r["method"] == method);
        of_method.map(|r| r["indirect_block_median"].as_f64().unwrap()).fold(f64::INFINITY, f64::min)
    };
    assert!(median("voxel proxy") > 2.0 * median("classic"));
    let report = std::fs::read_to_string(folder.path().join("report.html")).unwrap();
    assert!(report.contains("data:image/png;base64,") && report.contains("polyline") && !report.contains("http"));
    for name in ["cornell-patches.svg", "cornell-receivers.svg"] {
        assert!(std::fs::read_to_string(folder.path().join(name)).unwrap().starts_with("<svg xmlns="), "{name}");
    }
    assert!(leftovers(folder.path()).is_empty() && leftovers(&folder.path().join("cornell")).is_empty());

    // A run that goes on measures nothing twice, but what is missing; it does not go on from other settings.
    let missing = rows.iter().filter(|row| row["what"] != "axis").collect::<Vec<_>>();
    let mut less = summary.clone();
    less["rows"] = serde_json::json!(missing);
    std::fs::write(folder.path().join("summary.json"), less.to_string()).unwrap();
    succeeds(&[&arguments[..], &["--resume"]].concat());
    let again = std::fs::read_to_string(folder.path().join("summary.json")).unwrap();
    let again: serde_json::Value = serde_json::from_str(&again).unwrap();
    let seconds = |rows: &serde_json::Value, is_axis: bool| {
        let of_kind = rows.as_array().unwrap().iter().filter(|row| (row["what"] == "axis") == is_axis);
        of_kind.map(|row| row["bake_s"].clone()).collect::<Vec<_>>()
    };
    assert_eq!(seconds(&again["rows"], false), seconds(&summary["rows"], false));
    assert_ne!(seconds(&again["rows"], true), seconds(&summary["rows"], true));
    assert_eq!(again["rows"].as_array().unwrap().len(), rows.len());
    let again = std::fs::read_to_string(folder.path().join("report.html")).unwrap();
    assert_eq!(again.matches("data:image").count(), report.matches("data:image").count());
    let message = fails(1, &[&arguments[..], &["--resume", "--seed", "5"]].concat());
    assert!(message.contains("summary.json") && message.contains("--resume"), "{message}");

    // A part alone: its rows and its table, and no more.
    arguments.extend(["--parts", "lights"]);
    let markdown = succeeds(&arguments);
    assert!(markdown.contains("moved lamp") && !markdown.contains("voxel proxy |"), "{markdown}");
    let text = std::fs::read_to_string(folder.path().join("summary.json")).unwrap();
    let summary: serde_json::Value = serde_json::from_str(&text).unwrap();
    let parts = summary["rows"].as_array().unwrap().iter().map(|row| row["part"].clone()).collect::<Vec<_>>();
    assert_eq!(parts, ["lights"; 3]);
}

#[test]
fn bench_operator_keeps_the_error_of_every_kind_of_patches() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().to_str().unwrap();
    let mut arguments = vec!["operator", "cornell", "--out", out, "--device", "cpu", "--quiet"];
    arguments.extend(["--kinds", "axis,cluster", "--counts", "300", "--rays", "256", "--epsilons", "0.1,0.02"]);
    arguments.extend(["--codecs", "bc1", "--receivers", "700", "--receiver-rays", "64", "--receiver-epsilons", "0.1"]);
    let markdown = succeeds(&arguments);
    assert!(markdown.contains(" axis to 700 |") && markdown.contains(" cluster |"), "{markdown}");
    let text = std::fs::read_to_string(folder.path().join("summary.json")).unwrap();
    let summary: serde_json::Value = serde_json::from_str(&text).unwrap();
    let rows = summary["rows"].as_array().unwrap();
    assert_eq!(summary["builds"].as_array().unwrap().len(), 2);
    for kind in ["axis", "cluster"] {
        let of = |operator: &str, method: &str| {
            let is_it =
                |r: &&serde_json::Value| r["kind"] == kind && r["operator"] == operator && r["method"] == method;
            rows.iter().filter(is_it).collect::<Vec<_>>()
        };
        // Three bounces and sparse rows of F, dense T, blocks of T, hits and sparse rows of F_r stand beside tiles.
        let counts =
            [("F", "low_rank"), ("T", "low_rank"), ("T", "bc1"), ("F_r", "low_rank"), ("F_r", "counts of hits")];
        assert_eq!(counts.map(|(operator, method)| of(operator, method).len()), [2, 2, 1, 1, 1], "{kind}: {summary}");
        for (operator, method) in [("F", "low_rank"), ("T", "low_rank"), ("F_r", "low_rank")] {
            for row in of(operator, method) {
                let number = |key: &str| row[key].as_f64().unwrap_or_else(|| panic!("{key}: {row}"));
                assert!(number("frobenius") > 0.0 && number("frobenius") <= number("epsilon"), "{row}");
                // Light, being even, meets errors of one sign.
                let worst = number("own_light").max(number("compact_lights"));
                assert!(worst > 0.0 && worst < 3.0 * number("epsilon"), "{row}");
                assert!(number("median_ms") > 0.0 && number("stored_bytes") <= number("bytes"), "{row}");
            }
        }
        let bytes = |k: usize| of("T", "low_rank")[k]["stored_bytes"].as_u64().unwrap();
        assert!(bytes(0) < bytes(1), "less error takes more bytes: {summary}");
    }
    let report = std::fs::read_to_string(folder.path().join("report.html")).unwrap();
    assert!(report.contains("polyline") && report.contains("Texture blocks") && !report.contains("http"));
    assert!(leftovers(folder.path()).is_empty());
}

#[test]
fn bench_firstshot_compares_both_ways_to_shoot() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().to_str().unwrap();
    succeeds(&["firstshot", "atrium:3000", "--counts", "100", "--error", "0.05", "--quiet", "--out", out]);
    let text = std::fs::read_to_string(folder.path().join("summary.json")).unwrap();
    let summary: serde_json::Value = serde_json::from_str(&text).unwrap();
    let rows = summary["rows"].as_array().unwrap();
    assert_eq!((rows.len(), summary["rates"].as_array().unwrap().len()), (9, 2));
    // Direct light at corners, and six tables, each of which takes more shadow rays.
    let direct: Vec<u64> =
        summary["direct_light"].as_array().unwrap().iter().map(|d| d["shadow_rays"].as_u64().unwrap()).collect();
    assert!(direct.len() == 7 && direct[0] > 0 && direct[2..].iter().any(|&rays| rays > direct[0]), "{summary}");
    for row in rows {
        let number = |key: &str| row[key].as_f64().unwrap_or_else(|| panic!("{key}: {row}"));
        assert!(number("error") <= 0.05 && number("photons") > 0.0 && number("registered") > 0.0);
        assert!(row["curve"].as_array().unwrap().len() > 1);
        if row["method"] == "first shot" {
            // Both find the same light.
            assert!(number("difference") < 2.0 * number("expected_difference"), "{row}");
        }
    }
    let photons = |k: usize| rows[k]["photons"].as_f64().unwrap();
    assert!(photons(1) > photons(3), "first shot takes fewer photons: {summary}");
    for name in ["report.md", "report.html", "error-photons.svg", "error-seconds.svg"] {
        assert!(folder.path().join(name).is_file(), "{name}");
    }
    assert!(leftovers(folder.path()).is_empty());
}

#[test]
fn bench_frame_tells_where_the_time_of_light_updates_goes() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().to_str().unwrap();
    let mut arguments = vec!["frame", "atrium:3000", "--counts", "150", "--frames", "3", "--quiet"];
    arguments.extend(["--size", "64x48", "--rays", "64", "--receiver-rays", "32", "--device", "cpu", "--out", out]);
    let markdown = succeeds(&arguments);
    assert!(markdown.contains("| nothing moves |") && markdown.contains("ms to read once"), "{markdown}");
    let text = std::fs::read_to_string(folder.path().join("summary.json")).unwrap();
    let summary: serde_json::Value = serde_json::from_str(&text).unwrap();
    assert_eq!((&summary["name"], &summary["frames"]), (&"frame".into(), &3.into()));
    let row = |method: &str, event: &str, receivers: &str| {
        let is_row = |row: &&serde_json::Value| {
            row["method"] == method && row["event"] == event && row["receivers_updated"] == receivers
        };
        summary["rows"].as_array().unwrap().iter().find(is_row).unwrap_or_else(|| panic!("{method}, {event}")).clone()
    };
    let number = |row: &serde_json::Value, key: &str| row["light_update"][key].as_f64().unwrap();
    let part = row("tiles 1 %", "lights move", "in view");
    let all = row("tiles 1 %", "lights move", "all");
    assert!(number(&part, "visible_points") < number(&all, "visible_points"));
    assert!(number(&part, "visible_receivers") <= number(&all, "visible_receivers"));
    for method in ["temporal", "local", "classic"] {
        assert!(number(&row(method, "lights move", "in view"), "median_ms") > 0.0);
    }
    // Where nothing moves, nothing between the lights and the elements runs.
    let rest = row("tiles 1 %", "nothing moves", "in view");
    for pass in ["direct", "gather", "method", "lookup"] {
        assert_eq!(rest["passes"][pass].as_f64(), Some(0.0), "{pass}");
        assert!(part["passes"][pass].as_f64().unwrap() > 0.0, "{pass}");
    }
    let cost = &summary["points"][0];
    assert_eq!(cost["points"].as_u64(), Some(1000));
    assert!(cost["microseconds_a_point"].as_f64().unwrap() > 0.0, "{cost}");
    assert!(leftovers(folder.path()).is_empty());
}

/// summary.json of an experiment at its smallest setting, with what it says of a folder of documents.
fn study(name: &str) -> (tempfile::TempDir, serde_json::Value, String) {
    let folder = tempfile::tempdir().unwrap();
    let text = |name: &str| folder.path().join(name).to_str().unwrap().to_owned();
    let out = text("out");
    let docs = text("docs");
    let arguments = [name, "--quick", "--note", "in a test", "--out", &out, "--docs", &docs, "--device", "cpu"];
    let markdown = succeeds(&[&arguments[..], &["--quiet"]].concat());
    let read = |name: &str| std::fs::read_to_string(folder.path().join(name)).unwrap();
    let summary: serde_json::Value = serde_json::from_str(&read("out/summary.json")).unwrap();
    assert_eq!((&summary["name"], &summary["scenes"][0]["note"]), (&name.into(), &"in a test".into()));
    assert_eq!(read(&format!("docs/data/{name}.json")), read("out/summary.json"));
    assert!(read("out/report.html").contains("<table>") && !read("out/report.html").contains("http"));
    assert!(leftovers(&folder.path().join("out")).is_empty() && leftovers(&folder.path().join("docs")).is_empty());
    (folder, summary, markdown)
}

/// Kinds of methods of which every experiment has one.
const FAMILIES: [&str; 9] = [
    "tiles 1 %",
    "temporal",
    "gathering",
    "Monte Carlo",
    "voxel proxy",
    "DDGI",
    "LPV",
    "irradiance volume",
    "path tracing, denoised",
];

/// Rows of a scene, each with a number by the kind of its method.
fn numbers(rows: &serde_json::Value, path: &[&str]) -> Vec<(String, f64)> {
    let number = |row: &serde_json::Value| {
        let value = path.iter().fold(row, |value, key| &value[*key]);
        (row["family"].as_str().unwrap().to_owned(), value.as_f64().unwrap_or_else(|| panic!("{path:?}: {row}")))
    };
    rows.as_array().unwrap().iter().map(number).collect()
}

fn of(numbers: &[(String, f64)], family: &str) -> f64 {
    numbers.iter().find(|(own, _)| own == family).unwrap_or_else(|| panic!("{family}: {numbers:?}")).1
}

#[test]
fn bench_scaling_shows_how_light_updates_grow() {
    let (_folder, summary, markdown) = study("scaling");
    let rows = summary["scenes"][0]["rows"].as_array().unwrap();
    // What each axis is over, the number of its points, and that of the methods that it measures.
    let axes = [("patches", 2, 6), ("receivers", 1, 4), ("triangles", 2, 9), ("lights", 2, 9), ("pixels", 2, 9)];
    for (axis, points, methods) in axes {
        let of_axis: Vec<_> = rows.iter().filter(|row| row["axis"] == axis).collect();
        assert_eq!(of_axis.len(), points * methods, "{axis}");
        let mut sizes: Vec<u64> = of_axis.iter().map(|row| row["value"].as_u64().unwrap()).collect();
        assert!(sizes.windows(2).all(|pair| pair[0] <= pair[1]), "{axis}: {sizes:?}");
        sizes.dedup();
        assert_eq!(sizes.len(), points, "{axis}: {sizes:?}");
        assert!(markdown.contains(&format!("| method, over {axis} | {} |", sizes[0])), "{axis}: {markdown}");
        for row in of_axis {
            assert!(row["processor"]["median_ms"].as_f64().unwrap() > 0.0, "{row}");
            assert!(row["update"]["median_ms"].as_f64() <= row["update"]["max_ms"].as_f64(), "{row}");
            let is_path = row["family"].as_str().unwrap().starts_with("path");
            assert_eq!(row["bytes"] == 0, is_path, "{row}");
        }
    }
    // More patches take more memory, more pixels do not.
    let bytes = |axis: &str, family: &str| -> Vec<u64> {
        let is_it = |row: &&serde_json::Value| row["axis"] == axis && row["family"] == family;
        rows.iter().filter(is_it).map(|row| row["bytes"].as_u64().unwrap()).collect()
    };
    let of_patches = bytes("patches", "gathering");
    assert!(of_patches[0] < of_patches[1], "{of_patches:?}");
    assert_eq!(bytes("pixels", "DDGI")[0], bytes("pixels", "DDGI")[1]);
}

#[test]
fn bench_leaks_counts_light_behind_walls() {
    let (folder, summary, markdown) = study("leaks");
    let rows = &summary["scenes"][0]["rows"];
    assert!(markdown.contains("Leaks, % of the pixels") && markdown.contains("| method | rooms |"), "{markdown}");
    let leaks = numbers(rows, &["leak_share"]);
    assert_eq!(leaks.iter().map(|(family, _)| family.as_str()).collect::<Vec<_>>(), FAMILIES);
    assert!(leaks.iter().chain(&numbers(rows, &["stain_share"])).all(|(_, share)| (0.0..=1.0).contains(share)));
    // Patches stop at the wall, intensities of cells do not.
    let dark = numbers(rows, &["dark_ratio"]);
    assert!(of(&dark, "gathering") < of(&dark, "LPV") && of(&leaks, "gathering") < of(&leaks, "LPV"), "{rows}");
    assert!(summary["scenes"][0]["reference"].as_str().unwrap().contains("standard error"), "{summary}");
    let shown = summary["scenes"][0]["shown"].as_array().unwrap();
    assert_eq!(shown.len(), FAMILIES.len() + 1);
    assert!(folder.path().join("docs/pictures/leaks-rooms.png").is_file());
}

#[test]
fn bench_step_tells_when_a_jump_is_followed() {
    let (_folder, summary, markdown) = study("step");
    assert!(markdown.contains("| method | frames to 90 % |"), "{markdown}");
    let rows = &summary["scenes"][0]["rows"];
    // Products follow at once, probes do not; what is found anew in every frame is not still.
    for row in rows.as_array().unwrap() {
        match row["family"].as_str().unwrap() {
            "tiles 1 %" | "gathering" | "voxel proxy" => {
                assert_eq!((&row["followed_90"], &row["followed_99"]), (&1.into(), &1.into()), "{row}");
                assert_eq!((&row["change"], &row["noise_share"]), (&0.0.into(), &0.0.into()), "{row}");
            }
            "DDGI" => assert!(row["followed_90"].as_u64() > Some(1) && row["change"].as_f64() > Some(0.0), "{row}"),
            family if family.starts_with("path") => {
                assert!(row["change"].as_f64() > Some(0.01) && row["noise_share"].as_f64() > Some(0.01), "{row}");
            }
            _ => {}
        }
    }
}

#[test]
fn bench_materials_measures_errors_over_albedo() {
    let (_folder, summary, markdown) = study("materials");
    let scenes = summary["scenes"].as_array().unwrap();
    let names: Vec<&str> = scenes.iter().map(|scene| scene["scene"].as_str().unwrap()).collect();
    let albedos = ["cornell, albedo 0.2", "cornell, albedo 0.5", "cornell, albedo 0.8", "cornell, albedo 0.95"];
    assert_eq!(names, [&albedos[..], &["cornell, coloured", "cornell, textured"]].concat());
    assert!(markdown.contains("| method | cornell, albedo 0.2 |"), "{markdown}");
    for scene in scenes {
        let ratios = numbers(&scene["rows"], &["indirect", "mean_ratio"]);
        assert_eq!(ratios.iter().map(|(family, _)| family.as_str()).collect::<Vec<_>>(), FAMILIES);
        // All bounces of bright walls, too.
        assert!((of(&ratios, "gathering") - 1.0).abs() < 0.15, "{}: {ratios:?}", scene["scene"]);
        assert!(numbers(&scene["rows"], &["full", "psnr_db"]).iter().all(|(_, db)| *db > 3.0));
    }
}

#[test]
fn bench_unseen_measures_lights_that_no_bake_has_seen() {
    let (_folder, summary, markdown) = study("unseen");
    let rows = summary["scenes"][0]["rows"].as_array().unwrap();
    assert!(markdown.contains("| method | cornell, own light | cornell, moved lamp |"), "{markdown}");
    for light in ["own light", "moved lamp", "moved lamp, the other way"] {
        let of_light: Vec<_> = rows.iter().filter(|row| row["light"] == light).cloned().collect();
        let of_light = serde_json::Value::from(of_light);
        let ratios = numbers(&of_light, &["indirect", "mean_ratio"]);
        assert_eq!(ratios.iter().map(|(family, _)| family.as_str()).collect::<Vec<_>>(), FAMILIES, "{light}");
        // The light that shines, and no other, is in the picture.
        for family in ["tiles 1 %", "temporal", "gathering"] {
            assert!((of(&ratios, family) - 1.0).abs() < 0.2, "{light}: {family}: {ratios:?}");
        }
        let is_own = light == "own light";
        assert_eq!(numbers(&of_light, &["over_own"]).iter().all(|(_, ratio)| *ratio == 1.0), is_own, "{light}");
    }
}

#[test]
fn a_scene_is_added_to_those_that_documents_have() {
    let folder = tempfile::tempdir().unwrap();
    let text = |name: &str| folder.path().join(name).to_str().unwrap().to_owned();
    let out = text("out");
    let docs = text("docs");
    let run = |scene: &str, note: &str| {
        let mut arguments = vec!["step", scene, "--note", note, "--out", &out, "--docs", &docs, "--device", "cpu"];
        arguments.extend(["--counts", "100", "--size", "32x24", "--rays", "64", "--receiver-rays", "16", "--quiet"]);
        arguments.extend(["--spacings", "4", "--probe-rays", "16", "--sub-frames", "1"]);
        succeeds(&arguments);
        let kept = std::fs::read_to_string(folder.path().join("docs/data/step.json")).unwrap();
        serde_json::from_str::<serde_json::Value>(&kept).unwrap()["scenes"].as_array().unwrap().clone()
    };
    let first = run("cornell", "first");
    let second = run("rooms", "second");
    let of = |scenes: &[serde_json::Value]| -> Vec<(String, String)> {
        let text = |value: &serde_json::Value| value.as_str().unwrap().to_owned();
        scenes.iter().map(|scene| (text(&scene["scene"]), text(&scene["note"]))).collect()
    };
    let both = |a: &str, b: &str| vec![("cornell".to_owned(), a.to_owned()), ("rooms".to_owned(), b.to_owned())];
    assert_eq!(of(&second), both("first", "second"));
    // What was there is as it was, and measured again it is another.
    assert_eq!(second[0], first[0]);
    let third = run("cornell", "third");
    assert_eq!(of(&third), both("third", "second"));
    assert_eq!(third[1], second[1]);
    // What cannot be added to is said before anything is measured.
    std::fs::write(folder.path().join("docs/data/step.json"), "{}").unwrap();
    let message = fails(1, &["step", "cornell", "--out", &out, "--docs", &docs, "--quiet"]);
    assert!(message.contains("step.json") && message.contains("bench step"), "{message}");
}

#[test]
fn bench_clean_counts_faults_against_references_that_it_keeps() {
    let folder = tempfile::tempdir().unwrap();
    let text = |name: &str| folder.path().join(name).to_str().unwrap().to_owned();
    let out = text("out");
    let cache = text("cache");
    let shared = ["--cache", cache.as_str(), "--size", "48x32", "--quiet", "--device", "cpu"];
    let small = ["--counts", "150", "--rays", "64", "--receiver-rays", "32", "--sub-frames", "2", "--frames", "2"];
    let run = |scenes: &[&str], more: &[&str]| -> Vec<String> {
        let parts = [&["clean"][..], scenes, &shared, more];
        parts.concat().into_iter().map(str::to_owned).collect()
    };
    let measure = |scenes: &[&str]| run(scenes, &[&small[..], &["--out", out.as_str()]].concat());

    // Without references it says how they are made.
    let first = measure(&["stripes", "rooms:wall=0.1"]);
    let message = fails(1, &parts(&first));
    assert!(message.contains("stripes, rooms:wall=0.1") && message.contains("--references"), "{message}");
    let made = succeeds(&parts(&run(&[], &["--paths", "16", "--references", "stripes"])));
    assert!(made.contains("stripes: 16 paths") && made.contains("standard error"), "{made}");
    succeeds(&parts(&run(&["rooms:wall=0.1", "--references"], &["--paths", "16"])));

    let markdown = succeeds(&parts(&first));
    assert!(markdown.contains("| stripes |") && markdown.contains("| rooms:wall=0.1 |"), "{markdown}");
    let read = || -> serde_json::Value {
        serde_json::from_str(&std::fs::read_to_string(folder.path().join("out/summary.json")).unwrap()).unwrap()
    };
    let summary = read();
    assert_eq!((&summary["name"], &summary["size"]), (&"clean".into(), &serde_json::json!([48, 32])));
    for row in summary["rows"].as_array().unwrap() {
        for key in ["noise_share", "leak_share", "stain_share", "teeth_share"] {
            assert!((0.0..=1.0).contains(&row[key].as_f64().unwrap()), "{key}: {row}");
        }
        for part in ["full", "indirect"] {
            assert!(row[part]["ssim"].is_number() && row[part]["leak_share"].is_number(), "{row}");
            assert!(row["reference_noise"][part]["median_relative_standard_error"].as_f64().unwrap() > 0.0, "{row}");
        }
        assert_eq!(row["reference_noise"]["paths"], 16);
        assert!(row["energy"]["balance"].as_f64().unwrap().abs() < 0.05, "{row}");
        assert!(row["energy"]["near"]["ratio"].as_f64().unwrap() > 0.5, "{row}");
        assert_eq!((row["leak_share"].clone(), row["blotch_p95"].clone()), {
            let indirect = &row["indirect"];
            (indirect["leak_share"].clone(), indirect["blotch_p95"].clone())
        });
    }
    let report = std::fs::read_to_string(folder.path().join("out/report.html")).unwrap();
    assert!(report.matches("data:image/png;base64,").count() == 2 * 12 && !report.contains("http"));
    for name in ["faults-indirect.png", "noise.png", "blotches.png", "full.exr"] {
        assert!(folder.path().join("out/rooms-wall-0.1").join(name).is_file(), "{name}");
    }
    assert!(leftovers(&folder.path().join("out")).is_empty());

    // The same against pictures that are twice as dark: all is a leak.
    let dark = folder.path().join("dark/stripes");
    std::fs::create_dir_all(&dark).unwrap();
    for name in ["full", "direct", "indirect"] {
        let mut picture = Picture::read(&folder.path().join(format!("out/stripes/{name}.exr"))).unwrap();
        picture.pixels.iter_mut().for_each(|p| *p *= 0.5);
        picture.write_exr(&dark.join(format!("{name}.exr")), Precision::Single).unwrap();
    }
    let against_dark = ["--references".to_owned(), text("dark")];
    succeeds(&parts(&[&measure(&["stripes"])[..], &against_dark].concat()));
    let row = read()["rows"][0].clone();
    assert!(row["leak_share"].as_f64().unwrap() > 0.9 && row["stain_share"] == 0.0, "{row}");
    assert!(row.get("reference_noise").is_none(), "what is not known is left out: {row}");
}

#[test]
fn a_device_and_an_output_that_cannot_be_are_refused_before_the_work() {
    let message = fails(1, &["firstshot", "atrium:3000", "--device", "vulkan"]);
    assert!(message.contains("--device vulkan") && message.contains("firstshot"), "{message}");
    let folder = tempfile::tempdir().unwrap();
    std::fs::write(folder.path().join("file"), "x").unwrap();
    let below = folder.path().join("file/below");
    let message = fails(1, &["clean", "no/such/scene.toml", "--out", below.to_str().unwrap()]);
    assert!(message.contains("file/below"), "{message}");
}

#[test]
fn a_bench_that_is_not_known_is_wrong_usage() {
    let message = fails(2, &["chairs"]);
    assert!(message.contains("chairs") && message.contains("patches"), "{message}");
    fails(2, &[]);
    for wrong in [["--counts", "0"], ["--densities", "-1"], ["--kinds", "hexagon"], ["--spp", "1"]] {
        fails(2, &["patches", "cornell", wrong[0], wrong[1]]);
    }
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().to_str().unwrap();
    let message = fails(1, &["patches", "no/such/scene.toml", "--quiet", "--out", out]);
    assert!(message.contains("no/such/scene.toml"), "{message}");
}

#[test]
fn bench_table3_measures_every_method_alike() {
    let (folder, summary, markdown) = study("table3");
    assert!(markdown.contains("| DDGI 0.28 m, 32 rays |") && markdown.contains("| memory MB |"), "{markdown}");
    let rows = summary["scenes"][0]["rows"].as_array().unwrap();
    let of = |family: &str| rows.iter().filter(|row| row["family"] == family).collect::<Vec<_>>();
    for family in FAMILIES {
        // Two spacings, as many probes as take the time of tiles, and as many as fill their memory, if time allows.
        let count = match family {
            "DDGI" => 4,
            "tiles 1 %" | "temporal" | "LPV" | "irradiance volume" | "path tracing, denoised" => 2,
            _ => 1,
        };
        assert_eq!(of(family).len(), count, "{family}");
    }
    for own in ["tiles 1 %", "temporal"] {
        let bytes = |row: &serde_json::Value| row["bytes"].as_u64().unwrap();
        assert!(4 * bytes(of(own)[1]) < bytes(of(own)[0]), "{own}, small: {}", of(own)[1]);
    }
    assert_eq!(of("path tracing").len(), 2);
    for baseline in ["dense product", "shooting", "hierarchical"] {
        assert_eq!(of(baseline).len(), 1, "{baseline}: {summary}");
    }
    for row in rows {
        let number = |path: &[&str]| path.iter().fold(row, |value, key| &value[*key]).as_f64();
        let ratio = number(&["indirect", "mean_ratio"]).unwrap();
        let bound = if row["family"] == "voxel proxy" { 4.0 } else { 1.7 };
        assert!((0.3..bound).contains(&ratio), "{row}");
        assert!(
            number(&["update", "median_ms"]).unwrap() > 0.0 && number(&["full", "psnr_db"]).unwrap() > 5.0,
            "{row}"
        );
        let is_path = row["family"].as_str().unwrap().starts_with("path");
        assert_eq!(number(&["points", "median_relative_error"]).is_none(), is_path, "{row}");
        assert_eq!(number(&["bytes"]) == Some(0.0), is_path, "{row}");
    }
    let error = |family: &str| of(family)[0]["indirect"]["block_median_relative_error"].as_f64().unwrap();
    assert!(error("tiles 1 %") < error("LPV") && error("tiles 1 %") < error("voxel proxy"));
    let psnr = |family: &str| of(family)[0]["indirect"]["psnr_db"].as_f64().unwrap();
    assert!(psnr("path tracing, denoised") > psnr("path tracing"));
    // Baselines have the light of the same patches.
    for family in ["tiles 1 %", "temporal", "dense product", "Monte Carlo", "shooting"] {
        assert!((psnr(family) - psnr("gathering")).abs() < 0.5, "{family}: {} {}", psnr(family), psnr("gathering"));
    }
    // Links have patches of their own.
    assert!((psnr("hierarchical") - psnr("gathering")).abs() < 4.0, "{} {}", psnr("hierarchical"), psnr("gathering"));
    assert!(markdown.contains("| method | operator MB | ms to read it once |"), "{markdown}");
    assert!(folder.path().join("docs/pictures/table3-cornell.png").is_file());
    let report = std::fs::read_to_string(folder.path().join("out/report.html")).unwrap();
    assert_eq!(report.matches("data:image/png;base64,").count(), rows.len() + 1);
    assert!(report.contains("Nearest to tiles 1 % in memory"));
}

#[test]
fn bench_spread_shows_jumps_and_flicker_of_naive_ways() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().to_str().unwrap();
    let mut arguments = vec!["spread", "cornell", "--counts", "200", "--rays", "128", "--out", out];
    arguments.extend(["--receiver-rays", "16", "--quiet", "--json"]);
    let summary: serde_json::Value = serde_json::from_str(&succeeds(&arguments)).unwrap();
    let rows = summary["rows"].as_array().unwrap();
    let of = |way: &str, key: &str| {
        let row = rows.iter().find(|row| row["way"].as_str().unwrap().contains(way)).unwrap();
        row[key].as_f64().unwrap()
    };
    // Light that is shown when it is done jumps further than any frame's own step; parts flicker where light is at
    // rest.
    assert!(of("then shown", "jump_255") > 2.0 * of("all bounces", "jump_255"));
    assert!(of("of the columns", "flicker_255") > 10.0 && of("a product a frame", "flicker_255") < 0.01);
    // Samples of the change do neither, and are near what exact products give.
    assert!(of("of the change", "jump_255") < 1.5 * of("all bounces", "jump_255"));
    assert!(of("of the change", "flicker_255") < 1.0 && of("of the change", "error") < 0.5 * of("then shown", "error"));
    // The larger w, the less noise and the more lag.
    assert!(of("w 0.95", "flicker_255") < of("w 0.5", "flicker_255") && of("w 0.95", "error") > of("w 0.5", "error"));
    for name in ["cornell-200-error.svg", "cornell-200-change.svg", "cornell-200-weights.svg", "report.html"] {
        assert!(folder.path().join(name).is_file(), "{name}");
    }
}

#[test]
fn bench_thesis_measures_what_is_printed_beside_ours() {
    let listed = succeeds(&["thesis"]);
    let message = fails(1, &["thesis", "9.9"]);
    let folder = tempfile::tempdir().unwrap();
    for (figure, scene, files) in [
        ("3.2", "cornell", &["logarithmic.svg", "linear.svg"][..]),
        ("3.3", "cornell", &["errors.png"]),
        ("3.10", "cornell", &["bounces.svg"]),
        ("3.11", "cornell", &["bytes.svg"]),
        ("4", "cornell", &["steps.svg"]),
        ("4.12", "atrium:3000", &["time.svg", "work.svg", "visible.svg"]),
        ("5.3", "cornell", &["pictures.png"]),
        ("5.4", "cornell", &["pictures.png"]),
        ("6.4", "cornell", &["distance.svg"]),
        ("table1", "cornell", &["time.svg"]),
        ("table2", "cornell", &[]),
    ] {
        assert!(listed.contains(&format!("{figure} ")) && message.contains(figure), "{listed} {message}");
        let out = folder.path().join(figure);
        let mut arguments = vec!["thesis", figure, scene, "--out", out.to_str().unwrap(), "--quiet"];
        arguments.extend(["--counts", "60,120", "--size", "64x48", "--spp", "8", "--sub-frames", "1", "--rays", "64"]);
        arguments.extend(["--receiver-rays", "32", "--device", "cpu"]);
        let markdown = succeeds(&arguments);
        assert!(markdown.contains(&format!("## Thesis {figure}, {}", scene.split(':').next().unwrap())), "{markdown}");
        let text = std::fs::read_to_string(out.join("summary.json")).unwrap();
        let summary: serde_json::Value = serde_json::from_str(&text).unwrap();
        let name = scene.split(':').next().unwrap();
        let rows = summary["scenes"][name].as_array().unwrap();
        assert!(rows.len() > 1, "{text}");
        for file in files {
            assert!(out.join(format!("{name}-{file}")).exists(), "{figure} {file}");
        }
        let of = |key: &str, what: &str| rows.iter().find(|row| row[key] == what).unwrap();
        match figure {
            "3.3" => {
                let mse = |settings: &str, order: &str| {
                    let is_it = |row: &&serde_json::Value| row["settings"] == settings && row["order"] == order;
                    rows.iter().find(is_it).unwrap()["block_mse"].as_f64().unwrap()
                };
                assert!(mse("as printed", "listing 3.1") > mse("ours", "projected logarithms"), "{text}");
            }
            // What is printed is a sum over the points of a voxel.
            "5.3" | "5.4" => {
                let brightness = |what: &str| of("what", what)["brightness"].as_f64().unwrap();
                assert!(brightness("as printed") > 1.5 * brightness("ours, patches receive"), "{text}");
            }
            "4.12" => {
                let last = rows.last().unwrap();
                assert!(last["last_drift"].as_f64().unwrap() > 1e-4, "{text}");
            }
            _ => {}
        }
    }
}

#[test]
fn bench_report_gives_what_is_committed() {
    let docs = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("../../lab/docs");
    let folder = tempfile::tempdir().unwrap();
    let data = folder.path().join("data");
    std::fs::create_dir(&data).unwrap();
    for file in std::fs::read_dir(docs.join("data")).unwrap().map(|file| file.unwrap().path()) {
        std::fs::copy(&file, data.join(file.file_name().unwrap())).unwrap();
    }
    let out = folder.path().to_str().unwrap();
    succeeds(&["report", "--out", out]);
    let read = |path: std::path::PathBuf| std::fs::read_to_string(&path).unwrap_or_else(|e| panic!("{path:?}: {e}"));
    let made = read(folder.path().join("experiments.md"));
    assert!(made == read(docs.join("experiments.md")), "docs/experiments.md is not what `bench report` makes");
    let plots: Vec<_> =
        std::fs::read_dir(folder.path().join("experiments")).unwrap().map(|f| f.unwrap().path()).collect();
    assert!(plots.len() >= 4);
    for plot in plots {
        let committed = docs.join("experiments").join(plot.file_name().unwrap());
        assert!(read(plot) == read(committed.clone()), "{committed:?} is not what `bench report` makes");
    }
    // Every picture is there.
    for link in made.split("](").skip(1).filter_map(|rest| rest.split_once(')')) {
        assert!(docs.join(link.0).exists(), "{}", link.0);
    }
    // Other data give another report.
    let text = read(data.join("table3.json"));
    std::fs::write(data.join("table3.json"), text.replacen("\"psnr_db\": ", "\"psnr_db\": 9", 1)).unwrap();
    succeeds(&["report", "--out", out]);
    assert_ne!(read(folder.path().join("experiments.md")), made);
    std::fs::write(data.join("table3.json"), "{}").unwrap();
    let message = fails(1, &["report", "--out", out]);
    assert!(message.contains("table3.json") && message.contains("bench table3"), "{message}");
}
