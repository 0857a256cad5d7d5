"""The named endpoints as tools of an MCP server (Model Context Protocol), for agents.

The tools call the functions of the endpoints, so the same checks and limits apply. Gradio's own MCP
server is not used: it stores pictures before their size is checked, and all agents share one
session, so that /render cannot use a run of /generate. Source of the protocol:
modelcontextprotocol.io, revision 2025-06-18, transport "Streamable HTTP" without sessions.
"""

from __future__ import annotations

import inspect
import logging
import re
from collections.abc import Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any
from urllib.parse import quote
from weakref import WeakKeyDictionary

import anyio
import gradio as gr
from anyio import to_thread
from gradio.context import LocalContext
from gradio.route_utils import get_root_url
from mcp import types
from mcp.server.lowlevel import Server
from mcp.server.streamable_http_manager import StreamableHTTPSessionManager
from starlette.requests import Request
from starlette.responses import JSONResponse, PlainTextResponse
from starlette.routing import BaseRoute, Route

from phy124.accuracy.promises import Promise
from phy124.generators.extras import DepthMap, OtherViews
from phy124.scene import Scene, View, preset_names

from .endpoints import NOTHING_YET, FitOptions
from .extras import Photographed
from .guard import NAME, address_of, make_name
from .line import FAILED
from .photo import FETCHES_NOTHING, save_data_url
from .progress import close_now
from .traffic import TOOLS
from .visitors import Visitor

if TYPE_CHECKING:
    from starlette.types import Receive, Scope, Send

    from .jobs import Studio

LOG = logging.getLogger("phy124.web")
FILES = (gr.Image, gr.File)
PATH = "the path that POST gradio_api/upload of this server returned."
FILE = f"A data: URL with base64, or {PATH}"
RUN = "The name of a run, as generate returned it."
DESCRIPTIONS = {
    "image": f"A picture of one object, or a file of Gaussians. {FILE}",
    "accuracy": "draft is the fastest, fine the most accurate.",
    "frames": "Number of frames; by default, that of the preset.",
    "changes": 'Changes of the scene by dotted path, for example {"material.E": 20000}.',
    "pick": "Point on the object, if the picture shows several: [x, y] from 0 to 1.",
    "up": "Axis that points up in a file of Gaussians, for example -y.",
    "front": "Axis that points to the front in a file of Gaussians.",
    "formats": "Further files to make.",
    "video": f"Video of the real object's motion: {PATH}",
    "elevation": "Elevation of the camera above the horizon [degrees].",
    **dict.fromkeys(("second", "third", "fourth"), f"Picture of a further object. {FILE}"),
}
"""Descriptions of arguments that are not declared as options of a section."""


@dataclass(frozen=True)
class Tool:
    """An endpoint with a name, described for agents."""

    name: str
    function: Any
    description: str
    parameters: Mapping[str, dict[str, Any]]
    """JSON schema of each argument of the tool, by the argument's name."""
    required: tuple[str, ...]
    files: frozenset[str]
    needs_run: bool
    outputs: tuple[str, ...]

    def schema(self) -> dict[str, Any]:
        """Return the JSON schema of all arguments of the tool together."""
        return {
            "type": "object",
            "properties": dict(self.parameters),
            "required": list(self.required),
            "additionalProperties": False,
        }

    def bind(self, request: Any, values: Mapping[str, Any]) -> list[Any]:
        """Return the values of all arguments, in the order of the function's parameters."""
        parameters = inspect.signature(self.function).parameters.values()
        sent = {"request": request, **values}
        return [sent.get(each.name, self._default(each)) for each in parameters]

    def _default(self, parameter: inspect.Parameter) -> Any:
        if parameter.default is not inspect.Parameter.empty:
            return parameter.default
        return self.parameters.get(parameter.name, {}).get("default")


def tools(page: gr.Blocks) -> dict[str, Tool]:
    """Return the tools of a page by name; each public endpoint is a tool."""
    described = page.get_api_info()["named_endpoints"]  # pyright: ignore[reportOptionalSubscript]
    public = [each for each in page.fns.values() if each.api_visibility == "public"]
    return {
        str(each.api_name): _tool(each, described[f"/{each.api_name}"])
        for each in public
        if f"/{each.api_name}" in described
    }


def _tool(function: Any, described: Mapping[str, Any]) -> Tool:
    name = str(function.api_name)
    arguments = described["parameters"]
    files = {str(each.label) for each in function.inputs if isinstance(each, FILES)}
    parameters = {each["parameter_name"]: _schema(name, each, files) for each in arguments}
    required = [each["parameter_name"] for each in arguments if not each["parameter_has_default"]]
    needs_run = any(isinstance(each, gr.State) for each in function.inputs)
    if needs_run:
        parameters["run"] = {"type": "string", "description": RUN}
        required.append("run")
    outputs = ["run" if isinstance(each, gr.State) else each.label for each in function.outputs]
    return Tool(
        name,
        function.fn,
        str(described.get("description") or function.fn.__doc__),
        parameters,
        tuple(required),
        frozenset(files),
        needs_run,
        tuple(outputs),
    )


def _schema(tool: str, argument: Mapping[str, Any], files: set[str]) -> dict[str, Any]:
    name, kind = argument["parameter_name"], argument["type"]
    if name in files:
        schema: dict[str, Any] = {"type": "string"}
    elif name in ("changes", "pick"):  # "any", Gradio's type of JSON, is invalid
        schema = {"type": "object" if name == "changes" else "array"}
    else:
        schema = {key: kind[key] for key in ("type", "enum", "items") if key in kind}
    if argument["parameter_has_default"]:
        default = schema["default"] = argument["parameter_default"]
        if default is None:
            schema["type"] = [schema["type"], "null"]
    return {**schema, "description": _describe(tool, name, files)}


def _describe(tool: str, name: str, files: set[str]) -> str:
    if name == "preset":
        lines = [f"{each}: {Scene.named(each).description}" for each in preset_names()]
        return "\n".join(["What happens to the object.", *lines])
    sections = (FitOptions,) if tool == "fit" else (OtherViews, DepthMap, Photographed, View)
    fields = [each.model_fields[name] for each in sections if name in each.model_fields]
    text = DESCRIPTIONS.get(name) or (fields[0].description if fields else "") or name
    return f"{text} {FILE}" if name in files and name not in DESCRIPTIONS else text


class ToolServer:
    """Answers the requests of AI agents that call the page's endpoints as tools.

    Each call of `generate` creates a new visitor, and so does a call of `measure` without a run.
    """

    def __init__(self, page: gr.Blocks, studio: Studio) -> None:
        self.studio, self.tools = studio, tools(page)
        self._runs: WeakKeyDictionary[Visitor, Any] = WeakKeyDictionary()
        """Value by which the endpoints identify each visitor's last run."""
        self._threads = anyio.CapacityLimiter(studio.settings.max_queue)
        self.server: Server[Any, Any] = Server("phy124")
        logging.getLogger("mcp").setLevel(logging.ERROR)  # its warnings quote the text of requests
        self.server.list_tools()(self._list)
        self.server.call_tool()(self._call)

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Answer a request; a running tool is stopped when the agent disconnects."""
        if scope["method"] != "POST":
            # The server has no streams to read and no sessions to delete.
            answer = PlainTextResponse("This is an MCP server: POST JSON-RPC.", 405)
            return await answer(scope, receive, send)
        manager = StreamableHTTPSessionManager(
            self.server, stateless=True, max_request_body_size=self.studio.settings.max_body
        )
        async with manager.run():
            await manager.handle_request(scope, receive, send)

    def routes(self) -> list[BaseRoute]:
        """Return the server's routes; Hugging Face reads the route /schema of a Space."""

        async def schema(_: Request) -> JSONResponse:
            return JSONResponse([each.model_dump(mode="json") for each in await self._list()])

        methods = ["GET", "POST", "DELETE"]
        return [
            Route(TOOLS, self, methods=methods),
            Route(f"{TOOLS}/", self, methods=methods),
            Route(f"{TOOLS}/schema", schema),
        ]

    async def _list(self) -> list[types.Tool]:
        return [
            types.Tool(name=each.name, description=each.description, inputSchema=each.schema())
            for each in self.tools.values()
        ]

    async def _call(self, name: str, arguments: dict[str, Any]) -> types.CallToolResult:
        """Run a tool; return errors as sentences for the agent, and log errors of the server."""
        try:
            if name not in self.tools:
                raise gr.Error(f"There is no tool {name[:40]}. Use {', '.join(self.tools)}.")
            result = await self._run(self.tools[name], arguments)
        except gr.Error as error:
            return _answer(error.message, {}, failed=True)
        except Exception:
            LOG.exception("a tool failed")
            return _answer(FAILED, {}, failed=True)
        return _answer(_summary(result), result)

    async def _run(self, tool: Tool, arguments: dict[str, Any]) -> dict[str, Any]:
        context = self.server.request_context
        request: Any = context.request
        token = str(arguments.pop("run", "")) if tool.needs_run else make_name()
        if not NAME.fullmatch(token):
            raise gr.Error(NOTHING_YET)
        name = f"session {token}"
        visit: Any = SimpleNamespace(cookies={}, session_hash=token, client=request.client)
        LocalContext.request.set(visit)
        values = {**arguments, **await self._stored(tool, arguments)}
        if tool.needs_run:
            visitor = self.studio.visitors.find(name)
            values["run"] = self._runs.get(visitor) if visitor is not None else None
        begun = tool.function(*tool.bind(visit, values))
        last = await self._finish(begun, name, context) if inspect.isgenerator(begun) else begun
        result = dict(zip(tool.outputs, last if isinstance(last, tuple) else (last,), strict=True))
        if "run" in result:
            self._runs[self.studio.visitors.get(name, address_of(visit))] = result["run"]
            result["run"] = token
        if "files" in result:
            root = get_root_url(request, TOOLS, None)
            result["files"] = [f"{root}/gradio_api/file={quote(path)}" for path in result["files"]]
        return result

    async def _stored(self, tool: Tool, arguments: Mapping[str, Any]) -> dict[str, str]:
        sent = {name: arguments[name] for name in tool.files if arguments.get(name) is not None}
        for name, value in sent.items():
            if re.match(r"[a-z]+://", value, re.IGNORECASE):
                raise gr.Error(f"{name}: {FETCHES_NOTHING}")
            if value.startswith("data:"):
                if name == "video":
                    raise gr.Error(f"{name}: A video cannot be a data: URL. Give {PATH}")
                sent[name] = await to_thread.run_sync(save_data_url, value, self.studio, name)
        return sent

    async def _finish(self, steps: Iterator[Any], name: str, context: Any) -> Any:
        token = context.meta.progressToken if context.meta else None
        last = None
        try:
            while True:
                step = await to_thread.run_sync(next, steps, None, limiter=self._threads)
                if step is None:
                    return last
                last = step
                if token is not None and (progress := self._progress(name)):
                    request_id = str(context.request_id)
                    await context.session.send_progress_notification(
                        token, **progress, related_request_id=request_id
                    )
        finally:
            with anyio.CancelScope(shield=True), suppress(ValueError):
                await to_thread.run_sync(close_now, steps)

    def _progress(self, name: str) -> dict[str, Any] | None:
        visitor = self.studio.visitors.find(name)
        job = next(reversed(visitor.jobs.values()), None) if visitor is not None else None
        if job is None:
            return None
        data = job.progress.data()
        if job.place:
            wait = f"about {job.seconds_to_start:.0f} s"
            return {"progress": 0, "message": f"Waiting for {job.place} other runs, {wait}."}
        step = next((each for each in reversed(data["stages"]) if each["total"]), None)
        message = f"{step['name']}: {step['done']} of {step['total']}" if step else "Started."
        return {"progress": data["elapsed"], "total": data["expected"] or None, "message": message}


def _answer(text: str, data: dict[str, Any], *, failed: bool = False) -> types.CallToolResult:
    content: list[types.ContentBlock] = [types.TextContent(type="text", text=text)]
    return types.CallToolResult(content=content, structuredContent=data or None, isError=failed)


def _summary(result: Mapping[str, Any]) -> str:
    """Return the run, the links and the sentences of a result as text for the agent."""
    lines = [f"run: {result['run']}"] if "run" in result else []
    lines += [str(result[name]) for name in ("sentence", "error") if result.get(name) is not None]
    lines += [f"[{Path(link).name}]({link})" for link in result.get("files", [])]
    promise = (result.get("report") or {}).get("promise") or {}
    if promise.get("error") is not None:
        lines.append(Promise(**promise).brief)
    return "\n".join(lines) or "Done."
