"""Events of an arm in words."""

from schemas.messages import ExecutionEvent, ExecutionKind


def event_sentence(event: ExecutionEvent) -> str:
    """An event of an execution in a few words."""
    match event.kind:
        case ExecutionKind.ACCEPTED:
            return f"{event.arm}: armed"
        case ExecutionKind.PHASE_REACHED:
            return f"{event.arm}: {event.phase.name.lower() if event.phase else 'next phase'}"
        case ExecutionKind.SEGMENT_ENDED:
            return f"{event.arm}: rests, until its next segment is planned from a fresh image"
        case ExecutionKind.FINISHED:
            return f"{event.arm}: finished"
        case ExecutionKind.REFUSED:
            return f"{event.arm}: refused ({event.code}): {event.reason}"
        case ExecutionKind.HELD:
            return f"{event.arm}: holds ({event.code}): {event.reason}"
