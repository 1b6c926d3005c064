"""Table I of the paper: the success rate of each policy, in percent, by configuration and background."""

CONFIGURATIONS = ("easy", "medium", "hard", "singularity", "occlusion")
BACKGROUNDS = ("paper", "chicken")
_RATES = {
    "direct": (95.2, 100.0, 90.0, 100.0, 90.0, 71.4, 71.4, 90.0, 100.0, 100.0),
    "robust": (100.0, 100.0, 94.4, 95.2, 100.0, 100.0, 100.0, 100.0, 100.0, 80.0),
}
TOTALS = {"direct": 90.5, "robust": 97.0}


def published_rate(policy: str, configuration: str, background: str) -> float | None:
    """What the paper reports, in percent; None for what it has not tried."""
    if configuration not in CONFIGURATIONS or background not in BACKGROUNDS:
        return None
    return _RATES[policy][len(BACKGROUNDS) * CONFIGURATIONS.index(configuration) + BACKGROUNDS.index(background)]
