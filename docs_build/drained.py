"""Extension of griffe that adds functions with derived signatures to the reference."""

from __future__ import annotations

import ast
import importlib
import inspect
from collections.abc import Iterator
from typing import Any

from griffe import (
    Attribute,
    Class,
    Docstring,
    Expr,
    ExprCall,
    ExprKeyword,
    ExprName,
    ExprSubscript,
    ExprTuple,
    Extension,
    Function,
    Module,
    Parameter,
    ParameterKind,
    Parameters,
)

from lfcal.base.progress import docstring_of

_ON_PROGRESS = Parameter(
    "on_progress", annotation="Callable[[Progress], None] | None", kind=ParameterKind.keyword_only, default="None"
)


class Drained(Extension):
    """Show ``x = drained(iter_x)`` as a function, and the settings of a solver as its parameters.

    The reference is made from the sources, in which ``x`` is a value, and a solver has one parameter for its settings.
    A field of a record is shown with its declared help, unit and range, also as a parameter of a function.
    """

    def on_package(self, *, pkg: Module, **_: Any) -> None:
        """Replace these definitions after all modules of a package are read."""
        for place in _places(pkg):
            for solver in place.members.values():
                if isinstance(solver, Function):
                    _spread(solver, pkg)
                    _complete(solver)
        for place in _places(pkg):
            for name, value in list(place.members.items()):
                if isinstance(value, Attribute) and _is_drained(value.value):
                    place.set_member(name, _function(place, value, pkg))
                elif isinstance(value, Attribute) and isinstance(place, Class):
                    _describe(value)


def _places(place: Module | Class) -> Iterator[Module | Class]:
    """Yield a module or class, and all modules and classes in it."""
    yield place
    for inner in place.members.values():
        if isinstance(inner, Module | Class):
            yield from _places(inner)


def _spread(solver: Function, package: Module) -> None:
    """Replace the settings of a solver by their fields, if it is decorated with `with_settings`."""
    for decorator in solver.decorators:
        call = decorator.value
        if isinstance(call, ExprCall) and str(call.function) == "with_settings":
            (settings,) = call.arguments
            kind = package[str(getattr(settings, "canonical_path", settings)).removeprefix(f"{package.path}.")]
            own = [one for one in kind.parameters if one.name != "self"]
            solver.parameters = Parameters(*list(solver.parameters)[:2], *own)


def _complete(function: Function) -> None:
    """Set the complete docstring of a function that is decorated with `lfcal.records.described_by`."""
    said = function.docstring
    if said and any(str(decorator.value).startswith("described_by(") for decorator in function.decorators):
        run = getattr(importlib.import_module(function.module.path), function.name)
        said.value = inspect.cleandoc(run.__doc__)


def _describe(field: Attribute) -> None:
    """Set the docstring of a field that is declared by `lfcal.records.opt` to its help."""
    call = field.value
    declared = isinstance(call, ExprCall) and str(call.function) in ("opt", "required", "panel")
    if not declared or not isinstance(call, ExprCall):
        return
    plain = [argument for argument in call.arguments if not isinstance(argument, ExprKeyword)]
    named = {one.name: str(one.value) for one in call.arguments if isinstance(one, ExprKeyword)}
    required = str(call.function) == "required"
    words = ast.literal_eval(str(plain[0] if required else plain[1]))
    signs = {"unit": "", "above": "> ", "at_least": "≥ ", "below": "< ", "at_most": "≤ "}
    notes = [f"{sign}{named[name].strip(chr(39) + chr(34))}" for name, sign in signs.items() if name in named]
    notes += ["required"] if required else []
    field.docstring = Docstring(words + (f" ({'; '.join(notes)})" if notes else ""), parent=field)
    field.value = None if required else plain[0]


def _is_drained(value: Expr | str | None) -> bool:
    return isinstance(value, ExprCall) and isinstance(value.function, ExprName) and value.function.name == "drained"


def _function(place: Module | Class, value: Attribute, package: Module) -> Function:
    work = place.members[f"iter_{value.name}"]
    assert isinstance(work, Function) and isinstance(value.value, ExprCall)
    function = Function(
        value.name,
        parameters=Parameters(*work.parameters, _ON_PROGRESS),
        returns=_result(work.returns, package),
        lineno=value.lineno,
        endlineno=value.endlineno,
    )
    own = [ast.literal_eval(str(argument)) for argument in value.value.arguments[1:]]
    said = work.docstring or Docstring("")
    text = docstring_of(said.value, *own)
    how = {"parser": said.parser, "parser_options": said.parser_options}
    function.docstring = Docstring(text, parent=function, lineno=value.lineno, **how)
    return function


def _result(returns: Expr | str | None, package: Module) -> Expr | str | None:
    """Return R of ``Work[R]``, or of an alias such as ``SolverWork``."""
    if isinstance(returns, ExprName):
        alias = package[returns.canonical_path.removeprefix(f"{package.path}.")]
        returns = alias.value if isinstance(alias, Attribute) else None
    inner = returns.slice if isinstance(returns, ExprSubscript) else None
    return inner.elements[-1] if isinstance(inner, ExprTuple) else inner
