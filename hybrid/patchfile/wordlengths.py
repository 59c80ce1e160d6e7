"""The keys `word` and `words` of the digital machine: its word length, and that of single words."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from hybrid.errors import PatchError, did_you_mean, quoted
from hybrid.fields import Fields, in_words, only_keys, table_of
from hybrid.language import OVERFLOWS, ROUNDINGS, WORD_KEYS, WORD_LENGTHS, WORD_LENGTHS_OF_ALL
from hybrid.patch import WordSettings
from hybrid.patchfile.book import Book, tasks_of
from hybrid.units import PURE, Dimension
from hybrid.wordlength import SINGLE_BITS, Kind, Overflow
from hybrid.yamltree import Table, Text, Tree

SHORT: Mapping[str, WordSettings] = {
    "float64": WordSettings(),
    "float32": WordSettings(Kind.SINGLE, SINGLE_BITS),
}


Dimensions = Mapping[str, Dimension | None]


def read_word_length(book: Book, digital: Table) -> WordSettings:
    """The word length of all that has none of its own."""
    tree = digital.entries.get("word")
    return _settings(book, tree, "word of digital", PURE, of_all=True) if tree else WordSettings()


def read_word_lengths(
    book: Book, digital: Table, dimensions: Dimensions, words: Sequence[frozenset[str]]
) -> dict[str, WordSettings]:
    """Those of single words and states, and of all that a task gives one, sorted.

    words: of each task, or of the one program. What is given for a single word goes before what a task
    has for all of its own.
    """
    single = _single(book, digital, "words", dimensions, frozenset[str]().union(*words))
    found = dict(single)
    for (name, table, _), own in zip(tasks_of(digital), words, strict=False):
        what = f"task {name!r}"
        mine = _single(book, table, f"words of {what}", dimensions, own)
        for word in sorted(mine.keys() & single.keys()):
            raise PatchError(
                f"words of {what}: {word!r} has a word length in digital: words: too; give it one",
                table.places["words"],
            )
        if usual := task_word_length(book, name, table):
            found |= dict.fromkeys(own - single.keys(), usual)
        found |= mine
    return dict(sorted(found.items()))


def task_word_length(book: Book, name: str, table: Table) -> WordSettings | None:
    """The word length that a task gives all of its words; None where it gives none."""
    tree = table.entries.get("word")
    return _settings(book, tree, f"word of task {name!r}", PURE, of_all=True) if tree else None


def _single(
    book: Book, within: Table, what: str, dimensions: Dimensions, words: frozenset[str]
) -> dict[str, WordSettings]:
    """The word lengths of single words that a task or the machine gives."""
    tree, found = within.entries.get("words"), {}
    for word, item, place in table_of(tree, what, "word: word length") if tree else ():
        if word not in words:
            hint = did_you_mean(word, words)
            raise PatchError(f"{what}: no word or state {quoted(word)}; {hint}", place)
        found[word] = _settings(book, item, f"word length of {word!r}", dimensions[word])
    return found


def _settings(
    book: Book, tree: Tree, what: str, due: Dimension | None, of_all: bool = False
) -> WordSettings:
    """of_all: it is that of words of many units, so that its full scale has none of its own."""
    valid = WORD_LENGTHS_OF_ALL if of_all else WORD_LENGTHS
    if isinstance(tree, Text):
        if tree.text not in SHORT:
            raise PatchError(f"{what} is {quoted(tree.text)}; valid: {valid}", tree.place)
        return SHORT[tree.text]
    table = table_of(tree, what, "mantissa: bits, or fixed: bits")
    fields = Fields(table, what, WORD_KEYS, book.scope, table.place)
    kinds = [key for key in ("mantissa", "fixed") if key in table.entries]
    if len(kinds) != 1:
        raise PatchError(f"{what} needs either mantissa or fixed; valid: {valid}", table.place)
    cuts = _choice(fields, "rounding", ROUNDINGS) == "truncate"
    if kinds == ["mantissa"]:
        only_keys(table, [k for k in WORD_KEYS if k.name in ("mantissa", "rounding")], what)
        return WordSettings(Kind.BITS, fields.integer("mantissa", 0), cuts, place=tree.place)
    full_scale = fields.quantities(WORD_KEYS).get("full_scale")
    if full_scale is not None:
        _, dimension = fields.value_of(fields.tree("full_scale"), f"full_scale of {what}")
        if due is not None and dimension not in (None, PURE, due):
            given = in_words(dimension or PURE)
            raise PatchError(
                f"{what}: full_scale is {given}; it must be {in_words(due)}"
                + (
                    ": it holds for words of all units, in SI; words: takes units" if of_all else ""
                ),
                full_scale.place,
            )
    overflow = Overflow[_choice(fields, "overflow", OVERFLOWS).upper()]
    return WordSettings(
        Kind.FIXED, fields.integer("fixed", 0), cuts, full_scale, overflow, tree.place
    )


def _choice(fields: Fields, key: str, valid: tuple[str, ...]) -> str:
    """One of the words valid for a key, the first where it is not given."""
    text = fields.text(key, valid[0])
    if text not in valid:
        raise PatchError(
            f"{fields.what}: {key} is {quoted(text)}; valid: {', '.join(valid)}", fields.place(key)
        )
    return text
