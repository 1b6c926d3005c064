"""What becomes of a plan, in the words of commands and of the operator's page."""

from schemas.messages import ExecutionEvent, ExecutionKind


def event_told(event: ExecutionEvent) -> str:
    """An event of an execution, as a sentence without its full stop."""
    match event.kind:
        case ExecutionKind.ACCEPTED:
            return f"{event.arm} is armed"
        case ExecutionKind.PHASE_REACHED:
            return f"{event.arm}: {event.phase.name.lower() if event.phase else 'next phase'} done"
        case ExecutionKind.SEGMENT_ENDED:
            return f"{event.arm} rests, until its next segment is planned from a fresh image"
        case ExecutionKind.FINISHED:
            return f"{event.arm} has finished"
        case ExecutionKind.REFUSED:
            return f"{event.arm} refused ({event.code}): {event.reason}"
        case ExecutionKind.HELD:
            return f"{event.arm} holds ({event.code}): {event.reason}"
