"""Proxies: classes with the names of the asynchronous ones, whose calls block. Made by :func:`blocking_class`."""

from __future__ import annotations

import concurrent.futures
import functools
import inspect
import types
import weakref
from collections.abc import AsyncIterator, Callable, Iterator
from typing import Any, Final

from dpstack.blocking.portal import Call, Portal, the_portal

#: special methods that call the target's
_SPECIAL: Final = ("__len__", "__contains__", "__getitem__", "__setitem__", "__bool__")
#: a function whose annotated result begins with one of these returns an iterator, whose items may be waited for in vain
_ITERATORS: Final = {"AsyncIterator": "Items", "AsyncGenerator": "Items"}
#: awaitable objects, and the name of the class of their result
_AWAITED: Final = {"Connecting": "Connection"}
#: the proxy class of each asynchronous class
_CLASSES: Final[dict[type, type[Proxy]]] = {}


class Proxy:
    """A blocking object: calls, properties and assignments are carried out in the event loop by its target."""

    __slots__ = ("__weakref__", "_portal", "_target")
    _portal: Portal
    _target: Any

    def __init__(self, portal: Portal, target: object) -> None:
        object.__setattr__(self, "_portal", portal)
        object.__setattr__(self, "_target", target)
        self._prepare()

    def _prepare(self) -> None:
        """More attributes of a derived class."""

    def __getattr__(self, name: str) -> object:
        """Attributes that the class does not name."""
        __tracebackhide__ = True
        if name.startswith("_"):
            raise AttributeError(f"{type(self).__name__!r} object has no attribute {name!r}")
        value = self._portal.run(getattr, self._target, name)
        if inspect.ismethod(value):
            return functools.partial(_call, self._portal, value)
        return _wrap(self._portal, value)

    def __setattr__(self, name: str, value: object) -> None:
        __tracebackhide__ = True
        self._portal.run(setattr, self._target, name, _unwrap(value))

    def __repr__(self) -> str:
        return str(self._portal.run(repr, self._target))

    def __dir__(self) -> list[str]:
        names = {*object.__dir__(self), *dir(self._target)}
        return sorted(name for name in names if not name.startswith(("_portal", "_target", "__a")))

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Proxy) and bool(self._target == other._target)

    def __hash__(self) -> int:
        return hash(self._target)


class Items(Proxy):
    """An iterator of a bus. It waits for each item, ``timeout`` seconds at most, and then raises TimeoutError.

    After a TimeoutError, or Ctrl-C, the iteration goes on if it was: no item is lost.
    """

    __slots__ = ("_pending", "_timeout")
    #: the call that waits for the next item, alone in a list, or an empty list
    _pending: list[Call]
    _timeout: float | None

    def _prepare(self) -> None:
        object.__setattr__(self, "_pending", [])
        object.__setattr__(self, "_timeout", None)
        weakref.finalize(self, _leave, self._pending).atexit = False

    def __iter__(self) -> Items:
        return self

    def __next__(self) -> object:
        if not self._pending:
            self._pending.append(self._portal.start(anext, self._target))
        outcome = self._pending[0].outcome
        try:
            item = outcome.result(self._timeout)
        except BaseException as error:
            if outcome.done():
                self._pending.clear()
            if isinstance(error, StopAsyncIteration):
                raise StopIteration from None
            if isinstance(error, TimeoutError) and self._pending:
                raise TimeoutError(f"nothing came within {self._timeout:g} s; the iteration can go on") from None
            raise
        self._pending.clear()
        return _wrap(self._portal, item)

    def close(self) -> None:
        """End the iteration. May be repeated."""
        _leave(self._pending)
        concurrent.futures.wait([call.outcome for call in self._pending])
        self._pending.clear()
        self._portal.run(getattr(self._target, "close", None) or self._target.aclose)


def _leave(pending: list[Call]) -> None:
    for call in pending:
        call.cancel()


def _wrap(portal: Portal, value: object) -> object:
    """``value``, or its proxy; also within a tuple, list or dict."""
    kind = next((_CLASSES[kind] for kind in type(value).__mro__ if kind in _CLASSES), None)
    if kind is not None:
        return kind(portal, value)
    if isinstance(value, AsyncIterator):
        return Items(portal, value)
    if type(value) in (tuple, list):
        return type(value)(_wrap(portal, one) for one in value)  # type: ignore[call-arg,attr-defined]
    if type(value) is dict:
        return {key: _wrap(portal, one) for key, one in value.items()}
    return value


def _unwrap(value: object) -> object:
    return value._target if isinstance(value, Proxy) else value


def _call(portal: Portal, function: Callable[..., object], /, *args: object, **kwargs: object) -> object:
    __tracebackhide__ = True  # IPython and pytest leave such frames out of a traceback
    given = {key: _unwrap(value) for key, value in kwargs.items()}
    return _wrap(portal, portal.run(function, *map(_unwrap, args), **given))


# --- classes and functions ------------------------------------------------------------------------------------------


def blocking_signature(function: Callable[..., object]) -> inspect.Signature:
    """The signature of ``function`` without async: an iterator instead of an asynchronous one, with a timeout."""
    signature = inspect.signature(function)
    returns = signature.return_annotation
    head, bracket, rest = str(returns).partition("[")
    if head in _AWAITED:
        returns = _AWAITED[head]
    elif head in _ITERATORS:
        returns = _ITERATORS[head] + (bracket + rest.removesuffix(", None]").removesuffix("]") + "]" if bracket else "")
        if "timeout" not in signature.parameters:
            last = inspect.Parameter("timeout", inspect.Parameter.KEYWORD_ONLY, default=None, annotation="float | None")
            signature = signature.replace(parameters=_with(signature, last))
    return signature.replace(return_annotation=returns)


def _with(signature: inspect.Signature, parameter: inspect.Parameter) -> list[inspect.Parameter]:
    parameters = list(signature.parameters.values())
    at = len(parameters) - (bool(parameters) and parameters[-1].kind is inspect.Parameter.VAR_KEYWORD)
    return [*parameters[:at], parameter, *parameters[at:]]


def _dressed(made: Any, function: Callable[..., object]) -> Any:
    made = functools.wraps(function)(made)
    made.__signature__ = signature = blocking_signature(function)
    made.__annotations__ = {name: one.annotation for name, one in signature.parameters.items()}
    made.__annotations__["return"] = signature.return_annotation
    return made


def _takes_timeout(function: Callable[..., object]) -> bool:
    """Whether the blocking function has a ``timeout`` for items that the asynchronous one has not."""
    return len(blocking_signature(function).parameters) > len(inspect.signature(function).parameters)


def blocking_function(function: Callable[..., Any]) -> Callable[..., Any]:
    """The blocking form of a function of a module."""

    def call(*args: object, **kwargs: object) -> object:
        return _call(the_portal(), function, *args, **kwargs)

    return _dressed(call, function)  # type: ignore[no-any-return]


def _method(name: str, function: Callable[..., object]) -> Callable[..., object]:
    if _takes_timeout(function):

        def items(self: Proxy, *args: object, timeout: float | None = None, **kwargs: object) -> object:
            __tracebackhide__ = True
            made = _call(self._portal, getattr(self._target, name), *args, **kwargs)
            object.__setattr__(made, "_timeout", timeout)
            return made

        return _dressed(items, function)  # type: ignore[no-any-return]

    def method(self: Proxy, *args: object, **kwargs: object) -> object:
        __tracebackhide__ = True
        if name == "close" and self._portal.is_forked:  # the child of a fork has nothing to close
            return None
        return _call(self._portal, getattr(self._target, name), *args, **kwargs)

    return _dressed(method, function)  # type: ignore[no-any-return]


def _property(name: str, doc: str | None, *, settable: bool) -> property:
    def get(self: Proxy) -> object:
        __tracebackhide__ = True
        return _wrap(self._portal, self._portal.run(getattr, self._target, name))

    def set_(self: Proxy, value: object) -> None:
        __tracebackhide__ = True
        self._portal.run(setattr, self._target, name, _unwrap(value))

    return property(get, set_ if settable else None, doc=doc)


def _enter(self: Proxy) -> object:
    return _wrap(self._portal, self._portal.run(self._target.__aenter__))


def _exit(
    self: Proxy, kind: type[BaseException] | None, error: BaseException | None, trace: types.TracebackType | None
) -> object:
    if self._portal.is_forked:
        return None
    return self._portal.run(self._target.__aexit__, kind, error, trace)


def _iter(self: Proxy) -> Iterator[object]:
    return iter(self._portal.run(lambda: list(self._target)))  # type: ignore[call-overload,no-any-return]


def blocking_class(kind: type) -> Any:
    """The proxy class of ``kind``; ones of its base classes are made before."""
    bases = tuple(_CLASSES[base] for base in kind.__bases__ if base in _CLASSES)
    covered = {base for made in bases for base, proxy in _CLASSES.items() if proxy in made.__mro__}
    body: dict[str, object] = {"__doc__": kind.__doc__, "__module__": "dpstack.blocking", "__slots__": ()}
    for base in reversed([base for base in kind.__mro__ if base not in covered and base is not object]):
        if base.__module__.partition(".")[0] != "dpstack":
            continue
        body |= {
            name: _property(name, None, settable=False) for name in inspect.get_annotations(base) if name[0] != "_"
        }
        for name, member in vars(base).items():
            if isinstance(member, property) and name[0] != "_":
                body[name] = _property(name, member.__doc__, settable=member.fset is not None)
            elif inspect.isfunction(member) and (name[0] != "_" or name in _SPECIAL):
                body[name] = _method(name, member)
    if hasattr(kind, "__aenter__"):
        body |= {"__enter__": _enter, "__exit__": _exit}
    if "__iter__" in vars(kind):
        body["__iter__"] = _iter
    if issubclass(kind, AsyncIterator):
        bases = bases or (Items,)
        body.pop("__anext__", None)
        _ITERATORS[kind.__name__] = kind.__name__
    made: type[Proxy]
    made = _CLASSES[kind] = type(kind.__name__, bases or (Proxy,), body)
    return made


def asynchronous_class(kind: type[Proxy]) -> Any:
    """The class of the targets of a proxy class."""
    return next(target for target, made in _CLASSES.items() if made is kind)
