"""Source spans, diagnostics, the report that collects the diagnostics of a run, and hints."""

from __future__ import annotations

import contextlib
import enum
import re
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, replace
from typing import NamedTuple

from thorvaldc.diagnostics.codes import CODES, STRUCTURE, Code, all_codes, page
from thorvaldc.diagnostics.html_view import HtmlView

_MAX_TEXT = 2000  # characters of a message or hint


class Severity(enum.Enum):
    """The severity of a diagnostic: error, warning or note."""

    ERROR = "error"
    WARNING = "warning"
    NOTE = "note"


# `Span`, `Label` and `Fix` are named tuples for speed: an instance takes half the time of a frozen
# dataclass, and the class, which each command defines, a fifth.
class Span(NamedTuple):
    """A range of text in a source file, from ``line`` and ``column`` to ``end_line`` and
    ``end_column``.

    The line and column numbers of a source span start at 1.  The end column of a source span is
    exclusive.

    The field ``file`` is the path of the file from the command line, or a path relative to this
    file.  With relative paths, messages and outputs do not depend on the location of the project
    folder.
    """

    file: str
    line: int = 1
    column: int = 1
    end_line: int = 1
    end_column: int = 1

    def __str__(self) -> str:
        if self.file.startswith("--"):  # an option of the command line
            return self.file
        return f"{self.file}:{self.line}:{self.column}"


FIRST_USE = "first used here"
"""Text of a label: a name, an id or bits that two entries have, at the other entry."""


class Label(NamedTuple):
    """An additional source span of a diagnostic, with a text such as ``FIRST_USE``."""

    span: Span
    text: str


KeysBehind = Callable[[Span], list[Label]]


def _no_keys(_span: Span) -> list[Label]:
    return []


class Fix(NamedTuple):
    """A change of an input file that removes a diagnostic, for the quick fixes of editors.

    - ``span``: text to replace.  A span of length zero is a position at which text is inserted.
    - ``text``: new text.
    - ``is_example``: whether ``text`` contains an example value that the user has to adapt.
    """

    span: Span
    text: str
    is_example: bool = False


class Proposal(str):
    """A hint that proposes a concrete change of the input file.

    A hint that is plain text is advice only.

    - ``replacements``: new text of the source span, for each alternative in the hint.
    - ``span``: source span to replace, if it differs from the source span of the diagnostic.
    - ``word``: the misspelled word for which ``replacements`` contains known words.
    - ``is_example``: whether the replacements are examples that the user has to adapt.
    """

    replacements: tuple[str, ...]
    span: Span | None
    word: str
    is_example: bool

    def __new__(
        cls,
        hint: str,
        *replacements: str,
        span: Span | None = None,
        word: str = "",
        is_example: bool = False,
    ) -> Proposal:
        proposal = super().__new__(cls, hint)
        proposal.replacements = replacements
        proposal.span = span
        proposal.word = word
        proposal.is_example = is_example
        return proposal

    def within(self, text: str) -> Proposal:
        """Returns the hint for a misspelled word that is a part of ``text``."""
        pattern = rf"(?<!\w){re.escape(self.word)}(?!\w)" if self.word[-1:].isalnum() else None
        match = re.search(pattern, text) if pattern else None
        start = match.start() if match else text.find(self.word)
        end = start + len(self.word)
        return Proposal(str(self), *(text[:start] + new + text[end:] for new in self.replacements))

    def fixes(self, span: Span) -> tuple[Fix, ...]:
        """Returns the proposed changes of a diagnostic at ``span``."""
        return tuple(Fix(self.span or span, new, self.is_example) for new in self.replacements)


@dataclass(frozen=True, slots=True)
class Diagnostic:
    """An error, warning or note about an input file.

    - ``code``: diagnostic code.
    - ``message``: one sentence with the value, the limit and the unit.
    - ``span``: source span of the invalid value, or ``None`` if the input is not a file.
    - ``hint``: advice for the user.
    - ``labels``: further source spans with texts.
    - ``fixes``: changes of the input file that remove the diagnostic; the user chooses one.
    """

    code: Code
    message: str
    span: Span | None = None
    hint: str | None = None
    labels: tuple[Label, ...] = ()
    fixes: tuple[Fix, ...] = ()

    @property
    def severity(self) -> Severity:
        """Error, warning or note; all diagnostics of a code have the same severity."""
        return Severity(self.code.severity)

    def __repr__(self) -> str:
        place = f" at {self.span}" if self.span is not None else ""
        return f"<Diagnostic {self.code.number} {self.code.name}{place}: {self.message}>"


def _diagnostic(
    code: str, message: str, span: Span | None, hint: str | None, labels: Iterable[Label] = ()
) -> Diagnostic:
    fixes = hint.fixes(span) if isinstance(hint, Proposal) and span is not None else ()
    shown_hint = None if hint is None else _shortened(hint)
    return Diagnostic(CODES[code], message, span, shown_hint, tuple(labels), fixes)


class Accepted(NamedTuple):
    """A warning that the section ``accept`` of a document accepts.

    - ``diagnostic``: the warning.
    - ``reason``: the user's reason.
    - ``span``: the entry of the section.
    """

    diagnostic: Diagnostic
    reason: str
    span: Span


def _shortened(text: str) -> str:
    """Returns a text with at most ``_MAX_TEXT`` characters: a value in it can have any length."""
    half = _MAX_TEXT // 2
    return text if len(text) <= _MAX_TEXT else f"{text[:half]} … {text[-half:]}"


class Report(HtmlView):
    """A list of diagnostics in the order of detection, without repetitions.

    >>> import thorvaldc
    >>> report = thorvaldc.compile("examples/nowhere.yaml").report
    >>> report
    <Report: 1 error, 0 warnings>
    >>> [diagnostic.code.name for diagnostic in report]
    ['file-not-found']
    """

    html_view = "thorvaldc.diagnostics.renderers:render_html"

    def __init__(self) -> None:
        # Diagnostics of the report: original diagnostic -> diagnostic with the label of `used_by`.
        # The original diagnostics are stored to detect repeated diagnostics.
        self._diagnostics: dict[Diagnostic, Diagnostic] = {}
        self._user: Label | None = None
        self._keys_behind: KeysBehind = _no_keys
        self._accepted: dict[Accepted, None] = {}

    def add(
        self,
        code: str,
        message: str,
        span: Span | None = None,
        *,
        hint: str | None = None,
        labels: Iterable[Label] = (),
    ) -> None:
        """Adds a new diagnostic to the report.

        - ``code``: name of the diagnostic code, such as ``"can-id-duplicate"``.
        - ``message``: one sentence with the value, the limit and the unit.
        - ``span``: source span of the invalid value.
        - ``hint``: advice for the user.  A ``Proposal`` contains changes of the input file.
        - ``labels``: further source spans with texts.

        If the report already contains an equal diagnostic, the report does not change.  For
        example, a mistake in a module document is reported once, although a robot has nine modules
        of this type.
        """
        self.put(_diagnostic(code, _shortened(message), span, hint, labels))

    def put(self, diagnostic: Diagnostic) -> None:
        """Adds a diagnostic, unless the report already contains an equal diagnostic."""
        labelled, user, span = diagnostic, self._user, diagnostic.span
        if diagnostic in self._diagnostics:
            return
        if user is not None and span is not None and span.file != user.span.file:
            keys = self._keys_behind(span)
            if span.file.startswith("<"):  # the project's library: the user cannot change it
                labels = (Label(span, "found here"), *labelled.labels, *keys[1:])
                labelled = replace(labelled, span=user.span, labels=labels, fixes=())
                if keys:
                    hint = labelled.hint or "change this value, from which it follows"
                    labelled = replace(labelled, span=keys[0].span, hint=hint)
            else:
                labelled = replace(labelled, labels=(*labelled.labels, *keys, user))
        self._diagnostics[diagnostic] = labelled

    def extend(self, diagnostics: Iterable[Diagnostic]) -> None:
        """Adds several diagnostics to the report, in the given order.

        From another report, the accepted warnings are added too.
        """
        for diagnostic in diagnostics:
            self.put(diagnostic)
        if isinstance(diagnostics, Report):
            self._accepted.update(diagnostics._accepted)

    def accept(self, diagnostic: Diagnostic, reason: str, span: Span) -> None:
        """Moves a diagnostic of the report to the accepted warnings.

        - ``reason``, ``span``: the user's reason, and where it is written.
        """
        kept = {key: d for key, d in self._diagnostics.items() if d != diagnostic}
        self._diagnostics = kept
        self.add_accepted(Accepted(diagnostic, reason, span))

    def add_accepted(self, accepted: Accepted) -> None:
        """Adds an accepted warning, unless the report already contains an equal one."""
        self._accepted[accepted] = None

    @property
    def accepted(self) -> list[Accepted]:
        """The warnings that a document accepts, which do not count as warnings."""
        return list(self._accepted)

    @contextlib.contextmanager
    def used_by(self, user: Label, keys_behind: KeysBehind = _no_keys) -> Iterator[None]:
        """Adds a label to all diagnostics that are reported in a ``with`` block.

        - ``user``: label at the module instance in the robot file.
        - ``keys_behind``: labels at the keys of the robot file from which the value at a source
          span follows.

        A diagnostic in a module document gets the label ``user`` at the module in the robot file,
        because the parameters of the module can cause the diagnostic.  A diagnostic in the module
        library of Thorvald gets the source span of the first key behind it, or of ``user``, because
        the user cannot change the library.  The original source span becomes a label.
        """
        outer = self._user, self._keys_behind
        self._user, self._keys_behind = user, keys_behind
        try:
            yield
        finally:
            self._user, self._keys_behind = outer

    def __iter__(self) -> Iterator[Diagnostic]:
        return iter(self._diagnostics.values())

    def __len__(self) -> int:
        return len(self._diagnostics)

    def __repr__(self) -> str:
        return f"<Report: {self.summary()}>"

    def summary(self) -> str:
        """Returns the numbers of errors and warnings, such as ``1 error, 2 warnings``."""
        counts = ((len(self.errors), "error"), (len(self.warnings), "warning"))
        return ", ".join(f"{number} {noun}{'' if number == 1 else 's'}" for number, noun in counts)

    @property
    def errors(self) -> list[Diagnostic]:
        """The diagnostics that are errors, in the order of detection."""
        return [d for d in self if d.severity is Severity.ERROR]

    @property
    def hides_checks(self) -> bool:
        """True if an error of the structure keeps later checks from running."""
        return any(d.code.number[2] in STRUCTURE for d in self.errors)

    @property
    def warnings(self) -> list[Diagnostic]:
        """The diagnostics that are warnings, in the order of detection."""
        return [d for d in self if d.severity is Severity.WARNING]

    @property
    def has_errors(self) -> bool:
        """Whether a diagnostic of the report is an error."""
        return any(d.severity is Severity.ERROR for d in self._diagnostics)

    def sorted(self) -> list[Diagnostic]:
        """Returns all diagnostics of the report in the order of file, line and column.

        Diagnostics without a source span come last in the list.
        """
        last = Span("\U0010ffff")
        return sorted(self, key=lambda d: (d.span or last, d.code.number))

    def has_error_in(self, span: Span) -> bool:
        """Returns whether the report contains an error whose source span starts inside ``span``.

        Errors about unknown YAML keys (``unknown-key``) are ignored.
        """
        start, end = (span.line, span.column), (span.end_line, span.end_column)
        return any(
            d.span is not None
            and d.code.name != "unknown-key"
            and d.span.file == span.file
            and start <= (d.span.line, d.span.column) < end
            for d in self.errors
        )

    def excluding_spans_of(self, earlier: Report) -> Report:
        """Returns a report without diagnostics at the source spans of errors in ``earlier``."""
        known = {d.span for d in earlier.errors if d.span is not None}
        remaining = Report()
        remaining.extend(d for d in self if d.span not in known)
        return remaining


class OutsideError(Exception):
    """A failure of a disk, a display, a CAN bus or an installation, with a message on one line."""


class DiagnosticError(Exception):
    """Raised if an operation fails for the reason in the diagnostic.

    - ``diagnostic``: diagnostic with the reason and a hint.

    A function without a parameter of the type ``Report`` raises ``DiagnosticError`` instead of
    adding to a report.  A caller that has a ``Report`` adds the diagnostic of the exception to the
    report.
    """

    def __init__(
        self, code: str, message: str, span: Span | None = None, *, hint: str | None = None
    ) -> None:
        super().__init__(message)
        self.diagnostic = _diagnostic(code, message, span, hint)
        if hint:
            self.add_note(f"hint: {hint}")  # a traceback shows it below the message

    @property
    def one_line(self) -> str:
        """The message and the hint in one line."""
        return "; ".join(filter(None, (self.diagnostic.message, self.diagnostic.hint)))


# -- similar warnings ------------------------------------------------------------------

_NAME = r"`([^`]*)`"
_NUMBER = r"\d[\d.]*(e[+-]?\d+)?"
_SHOWN_PLACES, _SHOWN_NAMES = 3, 3


def grouped(diagnostics: Iterable[Diagnostic]) -> list[Diagnostic]:
    """Returns the diagnostics, with one diagnostic for similar warnings and notes.

    A file of others can give the same warning for each joint of an arm.  Diagnostics are similar if
    they have the same code and hint, and messages that differ only in names and numbers.  The first
    one stands for them: its message has their count and further names, and its labels show the
    first places.  Errors are not grouped, because each one must be corrected.
    """
    groups: dict[tuple[object, ...], list[Diagnostic]] = {}
    for number, diagnostic in enumerate(diagnostics):
        pattern = re.sub(_NUMBER, "0", re.sub(_NAME, "`", diagnostic.message))
        key: tuple[object, ...] = (diagnostic.code, pattern, diagnostic.hint)
        if diagnostic.severity is Severity.ERROR:
            key = (number,)
        groups.setdefault(key, []).append(diagnostic)
    return [_merged(group) if len(group) > 1 else group[0] for group in groups.values()]


def _merged(group: list[Diagnostic]) -> Diagnostic:
    first = group[0]
    message = f"{first.message} ({len(group)} places"
    first_names = re.findall(_NAME, first.message)
    others = {name: None for d in group for name in re.findall(_NAME, d.message)}
    names = [f"`{name}`" for name in others if name not in first_names]
    if names:
        more = ", ..." if len(names) > _SHOWN_NAMES else ""
        message += f"; also {', '.join(names[:_SHOWN_NAMES])}{more}"
    labels = list(first.labels)
    for diagnostic in group[1:]:
        # A macro gives the same span for each call; its calls differ.
        places = [diagnostic.span, *(label.span for label in diagnostic.labels)]
        seen = [first.span, *(label.span for label in labels)]
        place = next((p for p in places if p is not None and p not in seen), None)
        if place is not None and len(labels) < len(first.labels) + _SHOWN_PLACES - 1:
            labels.append(Label(place, "and here"))
    return replace(first, message=f"{message})", labels=tuple(labels))


# -- hints for misspelled words ---------------------------------------------------------


def nearest(word: str, known: Iterable[str], cutoff: float = 0.6) -> str | None:
    """Returns the known word most similar to ``word``, or ``None`` if no word is similar.

    The comparison of words ignores upper and lower case.  The comparison of words treats the
    characters ``-``, ``_`` and space as equal.  ``cutoff``: least similarity, 1 for equal words.
    """
    candidates = list(dict.fromkeys(known))
    by_normal = {_normal(candidate): candidate for candidate in reversed(candidates)}
    normal = _normal(word)
    if normal in by_normal:
        return by_normal[normal]
    if len(normal) > 100:
        return None
    import difflib

    close = difflib.get_close_matches(normal, list(by_normal), n=1, cutoff=cutoff)
    return by_normal[close[0]] if close else None


def did_you_mean(
    word: str, known: Iterable[str], otherwise: str | None = None, *, fixable: bool = True
) -> str | None:
    """Returns the hint ``did you mean `x`?`` for a misspelled word.

    The hint is a ``Proposal`` to replace the source span of the diagnostic by the known word.  If
    the source span is not that of the word, ``fixable`` is false and the hint is plain text.  If no
    known word is similar to the misspelled word, returns the text ``otherwise``.
    """
    known_word = nearest(word, known)
    if known_word is None:
        return otherwise
    hint = f"did you mean `{known_word}`?"
    return Proposal(hint, known_word, word=word) if fixable else hint


def _normal(word: str) -> str:
    return word.casefold().replace("-", "_").replace(" ", "_")


# -- numbers without exponents: nobody measures 1.05e+03 mm --------------------------------


def plain(value: float, digits: int = 6) -> str:
    """Returns a number with ``digits`` significant digits and no exponent, such as ``1046``.

    The digits before the decimal point are not rounded.  A number that no robot has, from 1e15 on
    or below 1e-12, keeps its exponent.
    """
    text = f"{value:.{digits}g}"
    if "e" not in text or not 1e-12 < abs(value) < 1e15:
        return text
    if abs(value) >= 1.0:
        return f"{value:.0f}"
    return f"{value:.15f}".rstrip("0").rstrip(".")


def millimetres(length: float, digits: int = 3) -> str:
    """Returns a length, given in m, with its unit, such as ``1046 mm``; from 10 m on in m."""
    if abs(length) >= 10.0:
        return f"{plain(length, digits)} m"
    return f"{plain(1000.0 * length, digits)} mm"


# -- codes by number or name -----------------------------------------------------------


class UnknownCode(LookupError):
    """Raised if no diagnostic code has the requested number or name.

    - ``hint``: suggestion of a similar code, or ``None``.
    """

    def __init__(self, number_or_name: str, hint: str | None) -> None:
        super().__init__(f"there is no code `{number_or_name}`")
        self.hint = hint


def find_code(number_or_name: str) -> Code:
    """Returns the diagnostic code with a number such as ``TV501`` or a name.

    - ``number_or_name``: ``TV501``, ``501`` or ``can-id-duplicate``, for example.

    Raises ``UnknownCode`` if no diagnostic code has this number or name.
    """
    text = number_or_name.strip()
    number = text.upper() if text.upper().startswith("TV") else f"TV{text}"
    for code in all_codes():
        if code.name == text.lower() or code.number in (number, text.upper()):
            return code
    names = [word for code in all_codes() for word in (code.name, code.number)]
    looks_like_number = text.isdigit() or text.upper().startswith("TV")
    hint = did_you_mean(number if looks_like_number else text, names)
    raise UnknownCode(number_or_name, hint)


def explain(number_or_name: str) -> str:
    """Returns the documentation page of a diagnostic code in Markdown.

    Raises ``UnknownCode`` if no diagnostic code has this number or name.
    """
    return page(find_code(number_or_name))
