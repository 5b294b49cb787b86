# skyherd with its live mode: docker build -t skyherd . && docker run --rm -v "$PWD/runs:/work/runs" skyherd run star
FROM python:3.12-slim
COPY . /src
RUN pip install --no-cache-dir "/src[live,study]" && rm -rf /src \
    && useradd --create-home skyherd && mkdir /work && chown skyherd /work
USER skyherd
WORKDIR /work
ENTRYPOINT ["skyherd"]
CMD ["--help"]
