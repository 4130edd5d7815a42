"""`owm evaluate prediction` end to end, on a tiny dataset."""

import json

import numpy as np
import pytest

from owm.baselines.least_squares import fit_least_squares
from owm.catalogue import predictors
from owm.checkpoint import save_world_model
from owm.data.recordings import training_episodes
from owm_envs.config import load_config
from owm_envs.datasets.generate import Request, generate
from owm_envs.files import FolderTaken


@pytest.fixture(scope="module")
def corpus(tmp_path_factory):
    folder = tmp_path_factory.mktemp("corpora") / "free"
    generate(folder, load_config(fidelity="iss", noise="cooperative", horizon=21.0), Request(8000, 200, 0, 0.0, 24))
    return folder


@pytest.mark.slow
def test_all_are_scored_on_the_same_instants_the_filter_with_the_longest_history(corpus, tmp_path, monkeypatch):
    train, _ = training_episodes(corpus, phases=1)
    save_world_model(fit_least_squares(train, history_length=12), tmp_path / "long")
    seen, score = {}, predictors.prediction_error
    monkeypatch.setattr(
        predictors, "prediction_error", lambda model, drawn, h: seen.update({model: drawn}) or score(model, drawn, h)
    )
    few = {"windows": 6, "spread_windows": 2, "out": tmp_path / "scored"}
    errors, spreads = predictors.evaluate_prediction([str(tmp_path / "long")], [corpus], **few)
    assert {model.name: model.history_length for model in seen}["EKF"] == 12
    assert sorted({model.history_length for model in seen}) == [8, 12]
    ends = [np.asarray(drawn.truth[:, -65:]) for drawn in seen.values()]
    for other in ends[1:]:
        np.testing.assert_array_equal(other, ends[0])
    (group,) = errors
    assert group == "free, behaviour" and [scored.name for scored in spreads[group]] == ["EKF"]
    mean = {error.name: error.mean("position_m")[3] for error in errors[group]}
    assert mean["EKF"] < mean["exact dynamics (iss)"] < mean["constant velocity"]
    names = [error.name for error in errors[group]]
    assert len(set(names)) == len(names) and str(tmp_path / "long") in names, "two fits of one name are told apart"
    written = json.loads((tmp_path / "scored" / "prediction.json").read_text(encoding="utf-8"))
    assert len(written["error"]) == 64 * len(seen) and (tmp_path / "scored" / "calibration.png").is_file()
    assert predictors.evaluate_prediction([str(tmp_path / "long")], [corpus], **few) == ({}, {}), "done already"
    with pytest.raises(ValueError, match="name each dataset once"):
        predictors.evaluate_prediction(["exact"], [corpus, corpus], **few)
    with pytest.raises(FolderTaken, match=r"scored holds another run, which differs in windows: choose another"):
        predictors.evaluate_prediction([str(tmp_path / "long")], [corpus], **few | {"windows": 7})
    with (tmp_path / "scored" / "prediction.json").open("a") as file:
        file.write(" ")
    monkeypatch.setattr(predictors, "training_episodes", begin_again)
    with pytest.raises(Begun):
        predictors.evaluate_prediction([str(tmp_path / "long")], [corpus], **few)


class Begun(Exception):
    pass


def begin_again(*_, **__):
    raise Begun
