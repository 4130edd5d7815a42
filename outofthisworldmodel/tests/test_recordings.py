"""What is trained on and what is set aside, of one dataset and of several."""

import shutil
from collections import Counter

import numpy as np
import pytest

from owm.cli import main
from owm.data import recordings
from owm.data.recordings import corpus_facts, training_episodes
from owm_envs.config import load_config
from owm_envs.datasets.generate import Request, generate


@pytest.fixture(scope="module")
def corpora(tmp_path_factory):
    """Two tiny datasets of one environment with other noise."""
    folder = tmp_path_factory.mktemp("corpora")
    for number, noise in enumerate(("cooperative", "none")):
        config = load_config(fidelity="iss", noise=noise, horizon=4.0)
        generate(folder / noise, config, Request(1900, 200, number, 0.5, 24))
    return folder / "cooperative", folder / "none"


def test_every_policy_is_judged_on_flights_set_aside(corpora):
    train, val = training_episodes(corpora[0], phases=1)
    recorded = Counter(recording.policy for recording in recordings.read_recordings(corpora[0], "train"))
    aside = {name: count - Counter(train.policies)[name] for name, count in recorded.items()}
    assert recorded["excite"] >= 8
    assert aside == {name: count // 8 if count >= 8 else int(count >= 3) for name, count in recorded.items()}
    assert Counter(val.policies)["excite"] == aside["excite"]
    seen = {row.tobytes() for row in train.view}
    assert not any(row.tobytes() in seen for row in val.view)


def test_several_corpora_are_pooled_and_no_window_crosses_from_one_to_the_other(corpora):
    one, other = (training_episodes(path, phases=2)[0] for path in corpora)
    both, _ = training_episodes(corpora, phases=2)
    assert len(both) == len(one) + len(other) and both.steps == one.steps + other.steps
    rows = both.starts(9)
    assert len(rows) == len(one.starts(9)) + len(other.starts(9))
    np.testing.assert_array_equal(both.episode[rows], both.episode[rows + 8])
    np.testing.assert_array_equal(both.view, np.concatenate([one.view, other.view]))


def test_a_recording_of_actions_held_for_a_step_is_taken_as_it_is(tmp_path):
    config = load_config(fidelity="iss", noise="none", horizon=8.0, steps_per_action=5)
    generate(tmp_path / "held", config, Request(300, 60, 2, 0.5, 24))
    recorded = recordings.read_recordings(tmp_path / "held", "train")
    assert {recording.stride for recording in recorded} == {1}
    episodes = recordings.at_model_rate(recorded, phases=5)
    assert episodes.dt == 0.25 and episodes.steps == sum(len(recording.action) for recording in recorded)
    first = episodes.track == 0
    np.testing.assert_allclose(episodes.view[first][:, :6], recorded[0].observation["state"][:, :6], rtol=1e-6)
    np.testing.assert_allclose(episodes.action[first][:-1], recorded[0].action, rtol=1e-6)


def test_a_damaged_corpus_is_refused_in_a_line_before_training(corpora, tmp_path, capfd):
    corpus = shutil.copytree(corpora[0], tmp_path / "corpus")
    info = corpus / "val/meta/info.json"
    info.write_text(info.read_text().replace('"fps": 20', '"fps": 4'))
    with pytest.raises(SystemExit) as stop:
        main(["train", "--data", str(corpus), "--out", str(tmp_path / "run")])
    said = capfd.readouterr().err.splitlines()[-1]
    assert stop.value.code == 2 and said.startswith("error: ") and "val/meta/info.json" in said
    assert not (tmp_path / "run").exists()


def test_a_corpus_tells_its_facts(corpora, tmp_path):
    facts = corpus_facts(corpora[0])
    assert facts["name"] == "cooperative" and facts["fidelity"] == "iss" and facts["dt"] == 0.05
    assert facts["noise"]["position"] == 0.05
    assert corpus_facts(tmp_path / "published") == {"name": "published"}
