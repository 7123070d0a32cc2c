"""Messages about an invalid scenario: one line for each problem."""

from __future__ import annotations

import difflib
from collections.abc import Iterable, Iterator, Sequence
from typing import cast

from pydantic import BaseModel, ValidationError

from hexservo.scenario.blocks import Blocks, Robot
from hexservo.scenario.keys import all_paths
from hexservo.scenario.rules import Rule, did_you_mean, shown_value

_MOST_PROBLEMS = 20  # reported of a scenario; of more only their number


def in_words(error: ValidationError, root: type[BaseModel] = Blocks) -> Iterator[str]:
    """Return one line for each problem found by pydantic, the first ones if there are many; `root` is what it read."""
    missing: dict[tuple[int | str, ...], list[str]] = {}
    problems = error.errors(include_url=False)
    for problem in problems[:_MOST_PROBLEMS]:
        place = problem["loc"]
        kind = problem["type"]
        if kind == "missing":
            missing.setdefault(place[:-1], []).append(str(place[-1]))
        elif kind == "extra_forbidden":
            named = _path(place) or '""'  # an empty key
            yield f"{named}: {_unknown_key(place, root)}"
        elif kind == "value_error":  # from a check of the whole, which places its own lines
            yield from str(problem["ctx"]["error"]).splitlines()
        elif kind == "scenario":
            yield f"{_path(place)}: {problem['msg']}"
        else:  # a block that is none
            keys_of_block = listing(_block(place, root))
            yield f"{_path(place)}: expected a block with the keys {keys_of_block}; got {shown_value(problem['input'])}"
    for place, keys in missing.items():
        block = _block(place, root)
        head = f"{_path(place)}: " if place else ""
        hint = "; a preset would fill them in" if block is Robot else ""
        yield f"{head}missing {'key' if len(keys) == 1 else 'keys'}: {_described(block, keys)}{hint}"
    if (more := len(problems) - _MOST_PROBLEMS) > 0:
        yield f"and {more} more {'problem' if more == 1 else 'problems'}"


def _path(place: Sequence[int | str]) -> str:
    return "".join(f"[{part}]" if isinstance(part, int) else f".{part}" for part in place).removeprefix(".")


def _block(place: Sequence[int | str], root: type[BaseModel]) -> type[BaseModel]:
    """Find the block at a place in a scenario, or in another document."""
    block = root
    for part in place:
        block = cast("type[BaseModel]", block.model_fields[str(part)].annotation)
    return block


def listing(block: type[BaseModel]) -> str:
    """Return the keys of a block, with commas between them."""
    return ", ".join(block.model_fields)


def _described(block: type[BaseModel], keys: Iterable[str]) -> str:
    """List keys with what each is expected to be."""
    texts = []
    for key in keys:
        rules = [rule.expected for rule in block.model_fields[key].metadata if isinstance(rule, Rule)]
        texts.append(f"{key} ({rules[0]})" if rules else key)
    return ", ".join(texts)


def _unknown_key(place: Sequence[int | str], root: type[BaseModel]) -> str:
    block = _block(place[:-1], root)
    key = str(place[-1])
    nearest = did_you_mean(key, block.model_fields)
    if not nearest:  # right key, wrong block
        paths = list(all_paths(root))
        names = difflib.get_close_matches(key.lower(), {path.rpartition(".")[2] for path in paths}, 1, 0.8)
        elsewhere = [f'"{path}"' for path in paths if names and path.rpartition(".")[2] == names[0]]
        nearest = f"; did you mean {' or '.join(elsewhere)}?" if elsewhere else ""
    return f"unknown key{nearest or ';'} known keys: {listing(block)}"
