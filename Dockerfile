# phy124 on a CPU, as an ordinary user; linux/amd64 and linux/arm64 (docs/guide/deploying.md).
FROM python:3.12-slim-bookworm AS build
COPY . /opt/source
RUN python3 -m venv /opt/phy124
RUN /opt/phy124/bin/pip install --no-cache-dir --no-compile --constraint /opt/source/constraints.txt "/opt/source[demo,bridge]"

FROM python:3.12-slim-bookworm
COPY --from=build /opt/phy124 /opt/phy124
# HOME holds the compiled kernels; anybody may write there, so that --user can be anybody.
ENV HOME=/home/phy124 PATH=/opt/phy124/bin:$PATH PHY124_HOST=0.0.0.0 PYTHONDONTWRITEBYTECODE=1
RUN useradd --uid 10001 --home-dir "$HOME" --create-home phy124 && chmod 777 "$HOME"
RUN mkdir /work && chmod 777 /work
USER phy124
WORKDIR /work

EXPOSE 7860
HEALTHCHECK --interval=30s --timeout=10s --start-period=2m \
    CMD python3 -c "import urllib.request as u; u.urlopen('http://127.0.0.1:7860/health', timeout=9)"
CMD ["phy124-demo"]
