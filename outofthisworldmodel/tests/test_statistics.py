import numpy as np
import pytest
from scipy.stats import binomtest

from owm.report.tables import percent
from owm.scores.statistics import holm, mcnemar, median_interval, pair, quantiles_by, rate, seeded_rate, wilson


@pytest.mark.parametrize(
    "count, total, low, high",
    # R. G. Newcombe, Statistics in Medicine 17 (1998) 857, table I, method 3.
    [(81, 263, 0.2553, 0.3662), (15, 148, 0.0624, 0.1605), (0, 20, 0.0, 0.1611), (1, 29, 0.0061, 0.1718)],
)
def test_wilson_intervals_match_published_values(count, total, low, high):
    assert wilson(count, total) == (pytest.approx(low, abs=5e-5), pytest.approx(high, abs=5e-5))


def test_none_of_400_is_under_one_percent_and_says_so():
    none, all_of_them = np.zeros(400, bool), np.ones(400, bool)
    assert wilson(0, 400)[1] == pytest.approx(0.0095, abs=5e-5)
    assert percent(rate(none)) == "0 % [0, 0.95]" and percent(rate(all_of_them)) == "100 % [99.05, 100]"
    assert percent(rate(np.arange(400) < 398)) == "99.5 % [98, 99.86]"
    assert percent(rate(np.zeros(0, bool))) == "–"


@pytest.mark.parametrize("first, second", [(0, 0), (5, 0), (10, 2), (2, 10), (7, 7), (40, 25)])
def test_mcnemar_is_the_exact_binomial_test(first, second):
    expected = binomtest(first, first + second).pvalue if first + second else 1.0
    assert mcnemar(first, second) == pytest.approx(expected, rel=1e-12)


def test_holm_adjusts_as_by_hand():
    # 4 x 0.005, 3 x 0.01, 2 x 0.03, then no less than that.
    assert holm([0.01, 0.04, 0.03, 0.005]) == pytest.approx([0.03, 0.06, 0.06, 0.02])
    assert holm([0.6, 0.7]) == [1.0, 1.0] and holm([]) == []


def test_pairs_count_common_starts_whatever_their_order():
    first = ("a", np.array(["s1", "s2", "s3", "s4"]), np.array([True, True, False, False]))
    second = ("b", np.array(["s4", "s3", "s1", "s9"]), np.array([True, False, True, True]))
    pairs = pair(first, second)
    assert (pairs.both, pairs.first_only, pairs.second_only, pairs.neither) == (1, 0, 1, 1)
    assert pairs.total == 3 and pairs.difference == pytest.approx(-1 / 3) and pairs.p == 1.0
    with pytest.raises(ValueError, match="no start in common"):
        pair(first, ("c", np.array(["s7"]), np.array([True])))
    with pytest.raises(ValueError, match="more than once"):
        pair(first, ("c", np.array(["s1", "s1"]), np.array([True, False])))


def test_intervals_over_seeds_hold_what_seeds_and_flights_leave_open():
    good, bad = np.ones(200, bool), np.zeros(200, bool)
    one = np.arange(200) < 150
    assert seeded_rate([one]) == rate(one)
    # Resampling two seeds of which one always fails: rates 0, 1/2, 1 with chances 1/4, 1/2, 1/4.
    apart = seeded_rate([good, bad])
    assert (apart["rate"], apart["low"], apart["high"]) == (0.5, 0.0, 1.0)
    # Seeds that agree in every flight are worth the flights of one.
    alike = seeded_rate([good, good, good])
    assert (alike["low"], alike["high"]) == wilson(200, 200) and alike["total"] == 600
    # Seeds that differ by one flight: the mean count is no whole one and is rounded outwards.
    near = seeded_rate([one, one, np.arange(200) < 151], draws=2)
    assert near["low"] <= wilson(150, 200)[0] and near["high"] >= wilson(151, 200)[1]
    # Seeds that vary no more than chance are wider than Wilson's of all flights, and hold the mean.
    rng = np.random.default_rng(0)
    some = seeded_rate([rng.random(200) < 0.7 for _ in range(3)])
    low, high = wilson(some["count"], 600)
    assert some["low"] < low < some["rate"] < high < some["high"]
    with pytest.raises(ValueError, match="equally often"):
        seeded_rate([good, good[:5]])


def test_quantiles_by_range_leave_out_what_is_missing():
    distance = np.array([0.5, 0.5, 0.5, 5.0, np.nan])
    rows = quantiles_by(distance, np.array([1.0, 2.0, 3.0, 9.0, np.nan]), (0, 1, 3, 10))
    assert [row["count"] for row in rows] == [3, 0, 1] and rows[0]["p50"] == 2.0 and np.isnan(rows[1]["p50"])


def test_the_interval_of_a_median_covers_it_as_often_as_it_says():
    assert median_interval(np.arange(5.0)) == (2.0, -np.inf, np.inf), "five values hold a median with 94 % at most"
    assert median_interval(np.arange(6.0)) == (2.5, 0.0, 5.0)
    # Conover's table for n = 20: the 6th and the 15th, 95.9 %.
    assert median_interval(np.arange(1.0, 21.0)) == (10.5, 6.0, 15.0)
    draws = np.random.default_rng(0).exponential(size=(2000, 21))
    held = [low <= np.log(2) <= high for _, low, high in map(median_interval, draws)]
    assert 0.95 <= np.mean(held) < 0.985
