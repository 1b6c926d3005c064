"""What was found out about one question to the images, in a sentence, well or not, or that they do not tell."""

from dataclasses import dataclass

from schemas.messages import Judgement, Severity

UNTOLD = "unknown"


@dataclass(frozen=True)
class Answer:
    """One question about the images and what they say to it.

    Fields:
        question: what was looked at, in a word or two.
        found: a sentence; one that begins with `unknown` says why the images do not tell.
        wrong: the judgement, where something is.
    """

    question: str
    found: str
    wrong: Judgement | None = None

    @property
    def is_known(self) -> bool:
        """Whether the images tell."""
        return not self.found.startswith(UNTOLD)


def well(question: str, found: str) -> Answer:
    """Nothing is wrong there."""
    return Answer(question, found)


def untold(question: str, why: str) -> Answer:
    """The images do not tell, and why."""
    return Answer(question, f"{UNTOLD}, for {why}")


def wrong(question: str, code: str, severity: Severity, finding: str, remedy: str) -> Answer:
    """Something is wrong there."""
    return Answer(question, finding, Judgement(code, severity, finding, remedy))


def judgements(answers: list[Answer]) -> tuple[Judgement, ...]:
    """What is wrong, the gravest first."""
    found = [answer.wrong for answer in answers if answer.wrong is not None]
    return tuple(sorted(found, key=lambda judgement: -judgement.severity.value))
