//! What a run's folder holds: its task, its state, its history, its weights. Each comes back from what is written of it.

use isoplanat::design::folder::same_scenes;
use isoplanat::design::joint::state::State;
use isoplanat::design::joint::story::Judgement;
use isoplanat::design::task::Task;
use isoplanat::interchange::{Form, text_of};
use isoplanat::lens::builtin;
use isoplanat::lens::catalogue::Glasses;
use isoplanat::network::{Reconstructor, UnetConfig};

use super::{again, file, models, place, read};

pub(super) fn task(bytes: &[u8]) {
    let Some(task) = read("task.toml", Task::load(&file("task.toml", bytes))) else { return };
    let text = again(task.to_toml(), "");
    let path = file("task.toml", text.as_bytes());
    assert_eq!(again(again(Task::load(&path), &text).to_toml(), &text), text);
}

pub(super) fn task_starts() -> Vec<Vec<u8>> {
    let names = ["edof", "edof-joint", "edof-free", "lfov-30", "lfov-30-free", "lfov-paper"];
    let tasks = names.map(|name| Task::load(name.as_ref()).expect("shipped"));
    tasks.iter().map(|task| task.to_toml().expect("valid").into_bytes()).collect()
}

/// The state of a stage, the judgements so far and the hash of what is trained on: each reader takes the same bytes.
pub(super) fn run(bytes: &[u8]) {
    if let Ok(text) = std::str::from_utf8(bytes)
        && let Some(state) = read("design.state", State::from_text(text, "design.state"))
    {
        let text = again(state.to_text(), text);
        assert_eq!(again(again(State::from_text(&text, "again"), &text).to_text(), &text), text);
    }
    let folder = place("");
    for name in ["history.jsonl", "scenes.sha256"] {
        file(name, bytes);
    }
    if let Some(judgements) = read("history.jsonl", Judgement::read(&folder)) {
        judgements.iter().for_each(|judgement| {
            let _ = judgement.score();
        });
    }
    read("isoplanat-fuzz-", same_scenes(&folder, "another"));
}

pub(super) fn run_starts() -> Vec<Vec<u8>> {
    let lens = builtin::lens("landscape").expect("shipped");
    let lens = text_of(&lens, Form::Toml, Glasses::shipped()).expect("TOML").0;
    let lens = format!("'''\n{lens}'''");
    let state = format!(
        "step = 3\nseconds = 1.5\nagain = 9\ndamping = 1.0\nrejected = 0\nrefreshed = 1\nrefreshing_seconds = 0.1\nsettled = [3, 9]\n\
         best = [30.0, 2]\nseen = [10.0, 0.01]\naround = {lens}\nlenses = [{lens}, {lens}, {lens}, {lens}, {lens}]\nlost = 0\nfineness = []\n\
         [remembered]\nfirst = [0.1]\nsecond = [0.2]\nsteps = 3\n[noise]\ncount = 1\nsums = [0.1]\nsquares = [0.01]\n\
         [distances]\npower = 2.0\nlosses = [0.1]\n"
    );
    let judgement = "{\"step\":1,\"seconds\":1.0,\"lens\":\"lenses/1.toml\",\"held_out_db\":[20.0,30.0],\"held_out_l1\":0.1,\"score_db\":30.0,\
                     \"best\":true,\"active\":[\"track\"],\"variables\":{\"surface[0].curvature\":0.1},\"certainty\":{}}\n";
    vec![state.into_bytes(), judgement.repeat(2).into_bytes(), "0123456789abcdef".repeat(4).into_bytes()]
}

pub(super) fn weights(bytes: &[u8]) {
    let path = file("network.safetensors", bytes);
    let config = read("network.safetensors", Reconstructor::config_of(&path));
    let Some(network) = read("network.safetensors", Reconstructor::load(&path)) else { return };
    assert_eq!(config.as_ref(), Some(network.config()));
    let second = place("again.safetensors");
    again(network.save(&second), "");
    assert_eq!(again(Reconstructor::load(&second), "").parameters(), network.parameters());
}

pub(super) fn weights_starts() -> Vec<Vec<u8>> {
    let (smallest, _) = models::smallest();
    let deeper = Reconstructor::new(UnetConfig::bare(1, 2), 1).expect("valid");
    let path = place("start.safetensors");
    let bytes = [smallest, deeper].map(|network| {
        network.save(&path).expect("writes");
        std::fs::read(&path).expect("reads")
    });
    bytes.to_vec()
}
