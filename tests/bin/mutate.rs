//! `cargo run --release -p integration-tests --bin mutate -- COUNT [FIRST]`: reads that many damaged files of every
//! format, from number FIRST on, and prints those that make a reader panic, hang or take too much memory. A worker
//! process reads them, and another goes on where one dies: a file may end it by a signal, too.

use std::collections::BTreeMap;
use std::io::{BufRead as _, BufReader, Write as _};
use std::process::{Command, ExitCode, Stdio};
use std::sync::mpsc::{self, RecvTimeoutError};
use std::time::Duration;

use integration_tests::mutate::{Corpus, MAX_TIME, Outcome};

/// Mark that tells a worker from the program itself.
const WORKER: &str = "worker";
/// Time after which a worker that says nothing hangs: it makes the sound files first, and the machine may be busy.
const SILENCE: Duration = Duration::from_secs(60);

fn main() -> ExitCode {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let number = |k: usize| arguments.get(k).and_then(|text| text.parse::<u32>().ok());
    match (arguments.first().map(String::as_str), number(0), number(1), number(2)) {
        (Some(WORKER), _, Some(first), Some(end)) => work(first, end),
        (_, Some(count), first, _) => supervise(first.unwrap_or(0), count),
        _ => {
            eprintln!("usage: mutate COUNT [FIRST]");
            ExitCode::from(2)
        }
    }
}

/// Reads mutants, and says before each which it is, and after it what came of it.
fn work(first: u32, end: u32) -> ExitCode {
    // Faults are reported as outcomes.
    std::panic::set_hook(Box::new(|_| {}));
    let corpus = Corpus::new();
    let mut out = std::io::stdout();
    for number in first..end {
        let (name, bytes) = corpus.mutant(number);
        let said = writeln!(out, "{number} {name}").and_then(|()| out.flush());
        let outcome = match corpus.read(name, &bytes) {
            Outcome::Read => String::from("read"),
            Outcome::Refused(_) => String::from("refused"),
            Outcome::Fault(what) => format!("fault {what}"),
        };
        if said.and_then(|()| writeln!(out, "{outcome}")).is_err() {
            return ExitCode::FAILURE;
        }
    }
    ExitCode::SUCCESS
}

/// Has workers read all mutants; fails when one was a fault.
fn supervise(first: u32, count: u32) -> ExitCode {
    let end = first.saturating_add(count);
    let mut faults: Vec<String> = Vec::new();
    let mut counts: BTreeMap<String, [u32; 2]> = BTreeMap::new();
    let mut next = first;
    while next < end {
        let Ok(mut worker) = worker(next, end) else {
            eprintln!("no worker can be started");
            return ExitCode::FAILURE;
        };
        let (sender, lines) = mpsc::channel();
        let out = worker.stdout.take();
        std::thread::spawn(move || {
            for line in out.into_iter().flat_map(|out| BufReader::new(out).lines()).map_while(Result::ok) {
                if sender.send(line).is_err() {
                    return;
                }
            }
        });
        let mut current: Option<(u32, String)> = None;
        let end_of_worker = loop {
            let line = match lines.recv_timeout(SILENCE) {
                Ok(line) => line,
                Err(RecvTimeoutError::Timeout) => break format!("it takes more than {} s", MAX_TIME.as_secs()),
                Err(RecvTimeoutError::Disconnected) => break String::from("it ends the process"),
            };
            if let Some((number, name)) = line.split_once(' ').and_then(|(k, name)| Some((k.parse().ok()?, name))) {
                current = Some((number, name.to_owned()));
                next = number;
                continue;
            }
            let Some((number, name)) = current.take() else { continue };
            next = number + 1;
            let [read, refused] = counts.entry(name.clone()).or_default();
            match line.strip_prefix("fault ") {
                Some(what) => faults.push(format!("{number} {name}: {what}")),
                None if line == "read" => *read += 1,
                None => *refused += 1,
            }
        };
        let _ = worker.kill();
        let _ = worker.wait();
        match current {
            Some((number, name)) => {
                faults.push(format!("{number} {name}: {end_of_worker}"));
                next = number + 1;
            }
            None if next < end => {
                eprintln!("the worker ended before {next}: {end_of_worker}");
                return ExitCode::FAILURE;
            }
            None => {}
        }
    }
    println!("{:12} {:>8} {:>8}", "file", "read", "refused");
    for (name, [read, refused]) in &counts {
        println!("{name:12} {read:8} {refused:8}");
    }
    for fault in &faults {
        println!("FAULT {fault}");
    }
    println!("{} faults in {count} files from {first} on", faults.len());
    if faults.is_empty() { ExitCode::SUCCESS } else { ExitCode::FAILURE }
}

fn worker(first: u32, end: u32) -> std::io::Result<std::process::Child> {
    let program = std::env::current_exe()?;
    let arguments = [WORKER, &first.to_string(), &end.to_string()];
    Command::new(program).args(arguments).stdin(Stdio::null()).stdout(Stdio::piped()).stderr(Stdio::null()).spawn()
}
